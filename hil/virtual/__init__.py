"""The control cycle in virtual time: lockstep with the emulated stage, replay of a recording, batches of plants.

Imports inside the room run down this list, never up: commands (the command line's thin shells) > sim, replay, emulate,
batch > scenario, lockstep, invariants. Only `commands` prints, exits or reads arguments.
"""
