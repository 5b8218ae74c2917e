"""The project's own drives: stage_fd and stage_classic."""
