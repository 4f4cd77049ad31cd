"""Ends with status 0 if the page at the address given answers within seconds; nothing of it is used."""

import signal
import ssl
import sys
import urllib.request

signal.alarm(6)  # for all of it, name look-up included
try:
    # Behind a company's own certificates pip may know what Python does not.
    urllib.request.urlopen(sys.argv[1], timeout=5, context=ssl._create_unverified_context()).close()
except OSError:
    sys.exit(1)
