"""Imported before anything else by a node: Ctrl-C while the rest is being imported ends it, without a traceback.

Nothing has been started by then that would have to be ended in order.
"""

import signal

signal.signal(signal.SIGINT, signal.SIG_DFL)
