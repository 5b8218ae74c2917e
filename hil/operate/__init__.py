"""What people run at the rig: watch it, command it, check it, install it."""
