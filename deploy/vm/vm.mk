# The VM lane: included by the Makefile. Everything it needs is kept in .vm/.
.PHONY: test-vm test-vm-again test-systemd test-vcan vm-lock vm-mutants counted

test-vm: setup  ## tests that need a real CAN stack, in a virtual machine with one (no KVM needed)
	@deploy/vm/test.sh

test-vm-again: setup  ## of test-vm, what failed the last time
	@deploy/vm/test.sh --last-failed

test-systemd: setup  ## the Debian package installed and run on a fresh guest with systemd as init
	@deploy/vm/test_systemd.sh

vm-mutants: setup  ## prove that the VM lane turns red when drivers/bus/port.py is broken
	@deploy/vm/mutants.py

test-vcan: setup  ## the same vcan tests on this machine, where its kernel has vcan
	@deploy/vm/test_vcan.sh

counted: setup compiled  ## a million ticks on a machine whose clock counts instructions, which no stall of this one delays (2 hours; ARGS=tick for another)
	@deploy/vm/counted.sh $(ARGS)

vm-lock:  ## renew deploy/vm/requirements.lock (needs uv)
	uv pip compile deploy/vm/requirements.in --universal --python-version 3.11 --generate-hashes \
	    --no-annotate --custom-compile-command "make vm-lock" -q -o deploy/vm/requirements.lock
