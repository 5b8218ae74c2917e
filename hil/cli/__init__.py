"""The command line, and what commands share: output, exit statuses, child processes, pictures."""
