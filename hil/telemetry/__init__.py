"""From the control process's memory-mapped ring to Zenoh, MCAP and back (commands)."""
