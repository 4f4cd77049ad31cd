"""How a task runs in time: environment, evaluation, jobs."""
