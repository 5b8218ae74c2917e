#!/bin/bash
# Runs inside the systemd guest, as its hil-test.service. /share is a directory of the host: package and tests in, results out.
cd /share/tests || exit 70
# the disk is thrown away: no need to wait for it
echo force-unsafe-io > /etc/dpkg/dpkg.cfg.d/unsafe-io
python3 -m pytest -p no:cacheprovider --rootdir /share/tests -c /dev/null -m systemd -vv --durations=10 \
    --junitxml=/share/results/junit.xml test_service.py >/share/results/pytest.log 2>&1
status=$?
journalctl --no-pager -o short-monotonic > /share/results/journal.log
echo $status > /share/results/status
sync
exit $status
