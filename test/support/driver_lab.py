"""Commands of a driver on a clock that the test advances in lock-step with them."""

from threads import in_a_thread, wait_for, wait_for_waiter

TICK = 0.01  # s


class Stop:
    """A stop signal, which is set by `now = True`."""

    def __init__(self, by=""):
        self.by = by
        self.now = False

    def is_set(self):
        return self.now


class Outcome:
    """A command in a thread, with its result or error."""

    def __init__(self, command, *arguments):
        self.result = self.error = None
        self.thread = in_a_thread(self._run, command, *arguments)

    def _run(self, command, *arguments):
        try:
            self.result = command(*arguments)
        except Exception as error:
            self.error = error

    def raise_error(self):
        if self.error is not None:
            raise self.error


class DriverLab:
    """A driver and the clock of its robot; tick_robot() of the derived class is the robot."""

    def __init__(self, make_driver):
        """make_driver: returns a driver for a clock."""
        self.now = 100.0
        self.driver = make_driver(lambda: self.now)
        self.driver._readiness.set_prepared()
        self._outcome = None  # of the last command

    def passes(self, seconds):
        """Advance the clock, in lock-step with the last command."""
        ends_at = self.now + seconds - 1e-9
        while self.now < ends_at:
            with self.driver._changed:  # a command that wakes up sees whole ticks only
                self.now += TICK
                self.tick_robot()
            self._wait_for_command()

    def tick_robot(self):
        """Advance the robot by TICK, send its state to the driver and receive the driver's command."""
        raise NotImplementedError

    def begins(self, command, *arguments):
        """Start a command in a thread."""
        self._outcome = Outcome(command, *arguments)
        self._wait_for_command()
        return self._outcome

    def runs(self, command, *arguments):
        """Run a command to its end; return its result or raise its error."""
        outcome = self.begins(command, *arguments)
        ends_at = self.now + 60.0
        while outcome.thread.is_alive():
            assert self.now < ends_at, "the command does not end"
            self.passes(TICK)
        outcome.raise_error()
        return outcome.result

    def ends(self, outcome):
        """Wait without a tick for the end of a command, and raise its error."""
        wait_for(lambda: not outcome.thread.is_alive())
        outcome.raise_error()

    def _wait_for_command(self):
        """Return once the last command waits for the next tick, or has ended."""
        if self._outcome is not None:
            wait_for_waiter(self._outcome.thread, self.driver._changed)
