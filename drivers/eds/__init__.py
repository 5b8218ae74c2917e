"""EDS and DCF files of CANopen devices (CiA 306-1): the one reader, for master and emulated drive alike."""
