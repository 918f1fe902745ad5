"""What pictures of all domains share: colours and files."""
