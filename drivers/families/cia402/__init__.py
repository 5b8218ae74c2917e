"""CANopen: CiA 301 services and CiA 402 drives, master side and node side."""
