"""Two arms that grasp a box by hitting it from both sides at once."""
