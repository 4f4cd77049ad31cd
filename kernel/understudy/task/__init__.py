"""What a task consists of: the interfaces of its parts."""
