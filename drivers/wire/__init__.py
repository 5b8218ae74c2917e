"""A simulated CAN segment in virtual time: frame lengths, arbitration, queues, fault confinement, injected errors."""
