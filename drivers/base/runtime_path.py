"""Where this user's runtime directory is; runtime.py makes it. Loads nothing else: `hil estop` is quick."""

import os

_MEMORY = "/dev/shm"  # on a disk, its journal stalls whoever writes a mapped page at the wrong moment (7 ms seen)
_DISK = "/tmp"
_SERVICE_DIRECTORY = "/run/hil"  # made by the systemd units (RuntimeDirectory=hil)


def runtime_path() -> str:
    """The first of: $HIL_RUNTIME_DIR, $RUNTIME_DIRECTORY (set by systemd), /run/hil where it exists and is writable,
    $XDG_RUNTIME_DIR/hil, /dev/shm/hil-<uid>, /tmp/hil-<uid>.
    """
    named = named_directory()
    if named:
        return os.path.abspath(named)
    if os.access(_SERVICE_DIRECTORY, os.W_OK | os.X_OK):
        return _SERVICE_DIRECTORY
    session = os.environ.get("XDG_RUNTIME_DIR")
    if session and os.access(session, os.W_OK | os.X_OK):
        return os.path.join(session, "hil")
    base = _MEMORY if os.access(_MEMORY, os.W_OK | os.X_OK) else _DISK
    return os.path.join(base, f"hil-{os.geteuid()}")


def named_directory() -> str:
    """What the environment names; empty where it names none."""
    return os.environ.get("HIL_RUNTIME_DIR") or os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]


def trusted_owner(path: str, owner: int) -> bool:
    """Whether a directory of that user may be this user's runtime directory.

    It must be one's own, root's too: whose directory it is decides what is found in it. Root may look at the service's,
    whose name in /run nobody else can take.
    """
    if owner == os.geteuid():
        return True
    return os.geteuid() == 0 and os.path.commonpath([path, _SERVICE_DIRECTORY]) == _SERVICE_DIRECTORY
