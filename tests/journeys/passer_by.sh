# Somebody in passing: what is it, and what does it look like?
set -eu
rtdenoise --version
rtdenoise --help | grep -i denois
rtdenoise demo
