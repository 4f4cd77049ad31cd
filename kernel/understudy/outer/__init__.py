"""Loops around whole trainings: trials, their journal, sweeps."""
