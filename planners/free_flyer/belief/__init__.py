"""What the expert knows: its plan as tables, and what it remembers and estimates of every world."""
