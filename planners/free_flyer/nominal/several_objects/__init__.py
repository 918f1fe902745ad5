"""Several objects: who hits what in which order, one object after another, and objects that give way to others."""
