"""What is missing, contradictory or dangerous in a user's files, before the first frame."""
