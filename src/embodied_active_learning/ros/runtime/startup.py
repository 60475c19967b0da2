"""Imported first by every node, before the slow imports: Ctrl-C during these ends the process without a traceback."""

import signal

signal.signal(signal.SIGINT, signal.SIG_DFL)
