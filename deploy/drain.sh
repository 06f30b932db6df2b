#!/usr/bin/env bash
# Take a server out from behind nginx without breaking a session, or put it back.
#
#   drain.sh out 127.0.0.1:8001     new requests go elsewhere; returns when its last WebSocket has ended
#   drain.sh in 127.0.0.1:8001
#
# SERVERS names the list of servers (/etc/nginx/drone-env-servers.conf), NGINX_COMMAND how nginx is called (nginx), WAIT for how
# many seconds to wait (3600). Exits with 1 where connections are left by then. Runs where nginx runs, and needs `ss`. The last
# server that is in stays in unless LAST=1 says so. Where nginx cannot be reloaded the list stays as it was.
set -euo pipefail
SERVERS=${SERVERS:-/etc/nginx/drone-env-servers.conf} NGINX_COMMAND=${NGINX_COMMAND:-nginx} WAIT=${WAIT:-3600}
if [[ $# -ne 2 || ($1 != in && $1 != out) || ! $2 =~ ^[0-9A-Za-z.:-]+$ ]]; then
  sed -n '2,9s/^# \?//p' "$0" >&2
  exit 2
fi
if [[ ! $WAIT =~ ^[0-9]+$ ]]; then
  echo "drain.sh: WAIT is a number of seconds, got '$WAIT'" >&2
  exit 2
fi
# Without it nothing would be seen to wait for.
command -v ss > /dev/null || { echo "drain.sh: ss is not installed (Debian's package iproute2)" >&2; exit 2; }
line="^server ${2//./\\.}[ ;]"
grep -q "$line" "$SERVERS" || { echo "drain.sh: $SERVERS has no line 'server $2 ...'" >&2; exit 2; }
others=$(grep "^server " "$SERVERS" | grep -v "$line" | grep -cv " down;" || true)
if [[ $1 == out && $others == 0 && ${LAST:-} != 1 ]]; then
  echo "drain.sh: $2 is the last server that is in, and without it nobody is answered; LAST=1 takes it out" >&2
  exit 2
fi
before=$(mktemp)
trap 'rm -f "$before"' EXIT
cp "$SERVERS" "$before"
sed -i "/$line/s/ down;/;/" "$SERVERS"
if [[ $1 == out ]]; then
  sed -i "/$line/s/;/ down;/" "$SERVERS"
fi
# Tried first: a reload of a broken configuration goes on with the old one, and says so only in the log.
if ! { $NGINX_COMMAND -t -q && $NGINX_COMMAND -s reload; }; then
  cat "$before" > "$SERVERS"
  echo "drain.sh: nginx was not reloaded; $SERVERS is as it was" >&2
  exit 1
fi
[[ $1 == in ]] && exit
sleep 1  # the old workers of nginx finish what they have begun
for ((waited = 1; waited < WAIT; waited++)); do
  connections=$(ss -Htn state established dst "$2")  # by itself: where ss fails, so does this
  [[ -z $connections ]] && exit
  sleep 1
done
echo "drain.sh: after $WAIT s there still are connections to $2" >&2
exit 1
