#!/bin/bash
# Runs inside the systemd guest, as its hil-test.service. /share is a directory of the host: package and tests in, results out.
cd /share || exit 70
# the disk is thrown away: no need to wait for it
echo force-unsafe-io > /etc/dpkg/dpkg.cfg.d/unsafe-io
# nobody is there to press Enter
echo 'APT::Get::Assume-Yes "true";' > /etc/apt/apt.conf.d/assume-yes
export DEBIAN_FRONTEND=noninteractive PYTHONDONTWRITEBYTECODE=1
python3 -m pytest -p no:cacheprovider --rootdir /share -c /dev/null -m "$(cat /share/marks)" -vv --capture=tee-sys --durations=10 \
    --junitxml=/share/results/junit.xml $(cat /share/arguments) >/share/results/pytest.log 2>&1
status=$?
journalctl --no-pager -o short-monotonic > /share/results/journal.log
echo $status > /share/results/status
sync
exit $status
