"""May this law go to the rig? `hil check --law`, and hil.accept_law."""
