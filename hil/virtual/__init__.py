"""The control cycle in virtual time: lockstep with the emulated stage, replay of a recording, batches of plants."""
