"""What motors and handles keep in their memory: reading, changing and storing it. For limp motors."""
