"""What the actions of yam-motors do."""
