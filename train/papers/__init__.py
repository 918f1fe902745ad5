"""Papers against here: published numbers, computed again by our commands."""
