"""Search for a law's gains on many plants at once."""
