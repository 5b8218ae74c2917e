#!/bin/sh
# Certificates for trying out mutual TLS: an authority of its own, and a directory each for a sidecar, an operator and a
# monitor (hil/telemetry/credentials.py). The role is the certificate's organizational unit. For a plant, use its own
# authority instead, and keep the authority's key off the rig's machine.
#
#   make-certificates.sh DIRECTORY [DAYS]       DAYS: how long they are valid [30]
set -eu
directory=${1:?which directory?}
days=${2:-30}
umask 077
mkdir -p "$directory/authority"
cd "$directory"
curve="ec -pkeyopt ec_paramgen_curve:prime256v1"

test -f authority/key.pem || openssl req -x509 -newkey $curve -noenc -days 3650 -subj "/CN=hil test authority" \
    -keyout authority/key.pem -out authority/authority.pem 2>/dev/null
test -f authority/secret || openssl rand -hex 32 > authority/secret

for role in sidecar operator monitor router; do
    mkdir -p "$role"
    openssl req -newkey $curve -noenc -subj "/OU=$role/CN=$role" -keyout "$role/key.pem" -out "$role/request.pem" 2>/dev/null
    printf 'subjectAltName=DNS:localhost,IP:127.0.0.1\nbasicConstraints=CA:FALSE\n' > "$role/extensions"
    openssl x509 -req -in "$role/request.pem" -CA authority/authority.pem -CAkey authority/key.pem -CAcreateserial \
        -days "$days" -extfile "$role/extensions" -out "$role/certificate.pem" 2>/dev/null
    cp authority/authority.pem "$role/"
    rm "$role/request.pem" "$role/extensions"
done
cp authority/secret sidecar/  # of those who command, and of whom they command
cp authority/secret operator/
echo "in $directory: sidecar/, operator/, monitor/, router/"
