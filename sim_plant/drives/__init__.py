"""The emulated servo drives: encoder, torque, state machine, watchdog; CiA 402 nodes."""
