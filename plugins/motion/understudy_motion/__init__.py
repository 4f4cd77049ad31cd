"""Motion clips: reading, checking, sampling. Nothing here knows a particular character."""
