"""The progress line."""

from embodied_active_learning.pipeline.progress import Progress, ProgressLine, ProgressPrinter, duration


def test_remaining_time_follows_the_pace():
    now = [0.0]
    line = ProgressLine(clock=lambda: now[0])
    assert "left -" in line.describe(Progress(0, 100, 0, 300))
    now[0] = 60.0
    values = {"loss": -1.25, "active_units": 16, "latent_size": 16, "ergodic_measure": 0.5, "latent_contribution": 0.7}
    text = line.describe(Progress(50, 100, 150, 300, **values))
    assert "step 50/100" in text
    assert "updates 150/300" in text
    assert "loss -1.250" in text
    assert "active units 16/16" in text
    assert "ergodic measure 0.500  latent 70 %" in text
    assert "left 1:00" in text


def test_stopping_criterion_ends_the_line():
    line = ProgressLine().describe(Progress(50, 100, 150, 300, stopping="objects 2"))
    assert line.endswith("left at most -  objects 2")


def test_progress_is_printed_every_30_s(capsys):
    now = [0.0]
    show = ProgressPrinter(clock=lambda: now[0])
    for step in range(61):
        now[0] = float(step)
        show(Progress(step, 100, 0, 0))
    printed = capsys.readouterr()
    assert [line.split("  ")[0] for line in printed.err.splitlines()] == ["step 0/100", "step 30/100", "step 60/100"]
    assert "left 0:40" in printed.err
    assert printed.out == ""


def test_stalled_run_has_no_remaining_time():
    now = [0.0]
    line = ProgressLine(clock=lambda: now[0])
    line.describe(Progress(5, 100, 0, 300))
    now[0] = 60.0
    assert "left -" in line.describe(Progress(5, 100, 0, 300))


def test_standstill_does_not_lengthen_time_left():
    """One step a second, with a pause of 1000 s after 30 of 100."""
    now = [0.0]
    line = ProgressLine(clock=lambda: now[0])
    for step in range(0, 31, 5):
        line.describe(Progress(step, 100, 0, 0))
        now[0] += 5.0
    for _ in range(200):
        assert "left 1:10" in line.describe(Progress(30, 100, 0, 0))
        now[0] += 5.0
    assert "left 1:05" in line.describe(Progress(35, 100, 0, 0))


def test_paused_run_names_who_paused_it():
    line = ProgressLine().describe(Progress(5, 100, 0, 300, paused_by="/fingerprinter"))
    assert line.endswith("paused by /fingerprinter")


def test_duration_is_formatted_as_clock():
    assert duration(59.6) == "1:00"
    assert duration(3725) == "62:05"
