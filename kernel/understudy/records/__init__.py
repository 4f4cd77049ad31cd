"""What is kept of a run: its folder, checkpoints, fault dumps."""
