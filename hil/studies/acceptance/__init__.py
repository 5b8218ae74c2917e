"""May this law go to the rig? `hil check --law`, `hil check --estimator`, and hil.accept_law."""
