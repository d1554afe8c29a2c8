import signal

# A shell that runs the tests in the background ignores interrupts, and whatever the tests interrupt would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)
