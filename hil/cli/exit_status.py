"""Exit statuses beside 0 and 1, numbered as in sysexits.h. The systemd units do not restart on 77 and 78."""

EXIT_FAULT = 3  # it went to its end, which was a latched fault; of hil sim, hil replay and hil demo
EXIT_UNAVAILABLE = 69  # EX_UNAVAILABLE: no bus, no runtime directory, no sidecar to ask, no port to listen on
EXIT_SOFTWARE = 70  # EX_SOFTWARE: the control cycle failed
EXIT_FILE = 74  # EX_IOERR: a file or folder named on the command line cannot be read or written
EXIT_REALTIME = 77  # EX_NOPERM: the kernel refused real time, and [timing] allow_degraded is false
EXIT_CONFIG = 78  # EX_CONFIG: the rig file, or an override of it
