"""What happened, told from the records of ticks and from what the cycle says in words. No tick runs any of it."""
