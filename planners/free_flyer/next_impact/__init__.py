"""Where, when and by whom an object is hit next."""
