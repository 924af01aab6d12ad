"""What the supervisor looks at, one kind a file."""
