# The compiled build of the hot path: included by the Makefile. It is what the Debian package holds; the interpreted source
# is the reference, and what `make run` and `make test` run.
COMPILED := .venv-compiled

.PHONY: compiled test-compiled test-slow test-nightly

compiled: $(COMPILED)/.built  ## .venv-compiled/bin/hil: the same program, its hot path compiled (needs a C compiler)

$(COMPILED)/.built: $(VENV)/.installed $(shell find hil drivers sim_plant deploy/compiled -name '*.py' -o -name '*.dbc' -o -name '*.eds' -o -name '*.[ch]')
	@$(BIN)/python deploy/compiled/build.py $(COMPILED)

# The very tests of the source, but for those that put a bug into a class. PYTHONSAFEPATH: a working directory full of
# sources must not take the build's place.
test-compiled: setup  ## the compiled build computes the same bytes and passes the tests of the source
	@$(BIN)/python deploy/compiled/build.py --check || { echo "test-compiled: skipped"; exit 0; }; \
	$(MAKE) --no-print-directory compiled && \
	PYTHONSAFEPATH=1 $(COMPILED)/bin/python -m pytest -n 2 --dist worksteal -m "not slow and not vcan and not controller" --slice $(or $(SLICE),1) $(ARGS)

test-nightly: SLICE := 1
test-nightly: test-long test-slow  ## what takes long, whole: fuzzing, fault campaign, random kills

test-slow: setup  ## what takes minutes, one in eight, drawn by the commit; on the compiled build where there can be one
	@if $(BIN)/python deploy/compiled/build.py --check; then \
	    $(MAKE) --no-print-directory compiled && python=$(COMPILED)/bin/python; else python=$(BIN)/python; fi && \
	PYTHONSAFEPATH=1 $$python -m pytest -n 2 --dist worksteal -m "slow and not vcan and not controller" --slice $(or $(SLICE),8) --durations=10 $(ARGS)
