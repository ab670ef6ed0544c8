"""What is said of it: a finding's words and numbers, and the next experiment."""
