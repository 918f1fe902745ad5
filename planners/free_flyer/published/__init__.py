"""The encoding and the plan files of Verhagen & Tumova, as published; nothing else needs them."""
