"""What the rig file says: its schema, its reading, whether its traffic fits the bus, where a run came from."""
