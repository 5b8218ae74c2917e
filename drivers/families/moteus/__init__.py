"""moteus controllers."""
