"""Contacts of free-flyers: when bodies touch, and what they do to each other then."""
