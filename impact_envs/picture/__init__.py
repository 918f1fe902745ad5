"""Pictures of a world: what is drawn where, films, and a window with keys."""
