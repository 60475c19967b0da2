"""Sweeps: runs, their records, and the command."""

import os
import pickle
import shutil
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest
import yaml

import embodied_active_learning as eal
from embodied_active_learning.config import CONFIG_VERSION
from embodied_active_learning.errors import DivergenceError, MissingPackageError, SessionError
from embodied_active_learning.session.checksummed_yaml import write_checksummed
from embodied_active_learning.session.paths import LOCK_FILE
from embodied_active_learning.sweep import jobs as sweep_jobs
from embodied_active_learning.sweep import runner
from embodied_active_learning.sweep.__main__ import main
from embodied_active_learning.sweep.jobs import Job
from embodied_active_learning.sweep.run_records import load_record, write_record
from embodied_active_learning.sweep.runner import make_runs, total_progress
from embodied_active_learning.sweep.spec import load_sweep
from stub_job import StubJob
from tiny import STEPS, TINY


def write_spec(folder, **changes):
    path = folder / "small.yaml"
    spec = {"worlds": ["diagonal"], "seeds": [0, 1], "overrides": {**TINY, **changes}}
    path.write_text(yaml.safe_dump(spec), encoding="utf-8")
    return path


def jobs_of(folder, **changes):
    sweep = load_sweep(write_spec(folder, **changes))
    return [Job(run, folder / "sessions", folder / "records", 1) for run in sweep.runs]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of a sweep of two runs, made in this process, and the lines it reported."""
    folder, lines = tmp_path_factory.mktemp("sweep"), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "_run_in_process", lambda job: job())
        assert make_runs(jobs_of(folder), 1, lines.append) == {}
    return folder, lines


@pytest.fixture
def copied(made, tmp_path):
    """A copy of that folder."""
    shutil.copytree(made[0], tmp_path / "copy")
    return tmp_path / "copy"


def test_run_of_sweep_equals_learn(made, tmp_path):
    config = eal.load_config("", root=str(tmp_path), name="alone", world="diagonal", seed=1, **TINY)
    alone = eal.learn(config).paths.path
    for name in ("exploration.csv", "training.csv", "evaluation.csv", "model.safetensors"):
        assert (made[0] / "sessions" / "run-diagonal-seed1" / name).read_bytes() == (alone / name).read_bytes(), name


def test_record_holds_config_summary_and_tables(made):
    record = load_record(made[0] / "records" / "run-diagonal-seed1")
    assert (record.variant, record.config.exploration.seed, record.failure) == ("run", 1, "")
    assert record.summary.finished
    assert record.summary.steps == STEPS
    assert list(record.tables["exploration"]["step"]) == list(range(1, STEPS + 1))
    text = (made[0] / "records" / "run-diagonal-seed1" / "record.yaml").read_text(encoding="utf-8")
    assert str(made[0]) not in text


def test_progress_is_reported(made):
    folder, lines = made
    assert lines[0].startswith(f"runs 0/2  steps 0/{2 * STEPS}  updates 0/{6 * STEPS}  left -")
    assert sum("run-diagonal-seed" in line for line in lines) == 2
    assert total_progress(jobs_of(folder)).share == 1.0


def test_recorded_run_is_not_repeated(copied, monkeypatch):
    """Neither with its session nor, as on another computer, without."""
    monkeypatch.setattr(sweep_jobs, "learn", lambda *arguments: pytest.fail("was made again"))
    shutil.rmtree(copied / "sessions")
    assert make_runs(jobs_of(copied), 1, str) == {}


def test_changed_settings_are_refused(copied):
    changed = {"training": {**TINY["training"], "learning_rate": 0.01}}
    with pytest.raises(SessionError, match=r"records/run-diagonal-seed0 .*learning_rate is 0.01 but was 0.001"):
        make_runs(jobs_of(copied, **changed), 1, str)
    shutil.rmtree(copied / "records")
    with pytest.raises(SessionError, match=r"sessions/run-diagonal-seed0 .*learning_rate is 0.01 but was 0.001"):
        make_runs(jobs_of(copied, **changed), 1, str)


def test_run_of_another_version_is_refused(copied):
    version = CONFIG_VERSION - 1
    for file, remedy in (
        ("records/run-diagonal-seed0/record.yaml", "otherwise delete the folder, and make the run again"),
        ("sessions/run-diagonal-seed0/config.yaml", "or delete .*/sessions/run-diagonal-seed0 to repeat the run"),
    ):
        content = {**yaml.safe_load((copied / file).read_text(encoding="utf-8")), "version": version}
        del content["sha256"]
        write_checksummed(copied / file, content)
        message = f"{file}: version is {version}, but this package reads version {CONFIG_VERSION} only: .*{remedy}$"
        with pytest.raises(SessionError, match=message):
            make_runs(jobs_of(copied), 1, str)
        shutil.rmtree(copied / "records", ignore_errors=True)


def test_interrupted_run_is_resumed(tmp_path, monkeypatch, capsys):
    job = jobs_of(tmp_path)[0]

    def interrupted(config, on_progress):
        def stop(progress):
            if progress.step == 15:
                raise KeyboardInterrupt

        return eal.learn(config, stop)

    with monkeypatch.context() as patch:
        patch.setattr(sweep_jobs, "learn", interrupted)
        with pytest.raises(KeyboardInterrupt):
            job()
    assert job.progress().step == 15
    assert not job.complete
    job()
    assert "step" not in capsys.readouterr().err, "the sweep reports progress itself"
    assert job.complete
    assert list(load_record(job.record).tables["exploration"]["step"]) == list(range(1, STEPS + 1))


def test_folder_of_an_uncreated_session_is_started_anew(tmp_path):
    """A process was killed between making the folder and writing the configuration."""
    job = jobs_of(tmp_path)[0]
    job.session.mkdir(parents=True)
    (job.session / LOCK_FILE).touch()
    job.check()
    assert job.progress().step == 0
    assert job.bytes_needed() > 0
    assert not job.started


def test_failed_run_does_not_stop_the_others(tmp_path, monkeypatch):
    def run(job):
        if job.run.name.endswith("seed0"):
            raise SessionError("the disk is full")
        return "completed"

    monkeypatch.setattr(runner, "_run_in_process", run)
    lines = []
    assert make_runs(jobs_of(tmp_path), 1, lines.append) == {"run-diagonal-seed0": "the disk is full"}
    assert "completed" in lines


def test_damaged_table_does_not_stop_the_report(copied):
    shutil.rmtree(copied / "records")
    job = jobs_of(copied)[0]
    (job.session / "summary.yaml").unlink()
    (job.session / "training.csv").write_text("loss\nnone", encoding="utf-8")
    assert runner.total_progress([job]).step == 0


def test_diverged_run_is_recorded_as_failed(copied, monkeypatch):
    def diverge(config, on_progress):
        raise DivergenceError("too large")

    shutil.rmtree(copied / "records")
    job = jobs_of(copied)[0]
    monkeypatch.setattr(sweep_jobs, "learn", diverge)
    job()
    assert load_record(job.record).failure == "too large"


def test_run_is_made_in_a_process_of_its_own(tmp_path):
    job = StubJob(tmp_path / "process")
    assert make_runs([job], 1, str) == {}
    assert int(job.path.read_text()) != os.getpid()


def test_job_is_sent_to_another_process(tmp_path):
    job = jobs_of(tmp_path)[0]
    assert pickle.loads(pickle.dumps(job)) == job  # noqa: S301 - written by this test


def test_crashed_process_is_reported(monkeypatch):
    """The process ends without a result, like one that is killed."""
    monkeypatch.setattr(runner, "_work", os._exit)
    with pytest.raises(SessionError, match="its process was killed or has crashed"):
        runner._run_in_process(SimpleNamespace(run=SimpleNamespace(name="run")))


def test_cluster_needs_submitit(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "submitit", None)
    with pytest.raises(MissingPackageError, match="pip install submitit"):
        make_runs(jobs_of(tmp_path), 1, str, "slurm")


def test_submitit_makes_runs(tmp_path):
    pytest.importorskip("submitit")
    jobs = jobs_of(tmp_path)
    assert make_runs(jobs, 2, str, "debug", {"timeout_min": 5}, tmp_path / "jobs") == {}
    assert all(job.complete for job in jobs)


def test_dry_run_lists_runs_disk_and_time(made, tmp_path, capsys):
    arguments = [str(write_spec(made[0])), "--root", str(tmp_path), "--dry-run"]
    assert main(arguments) == 0
    output = capsys.readouterr().out
    assert f"run-diagonal-seed0: 0 of {STEPS} steps" in output
    assert "time with 1 workers: unknown until a run is complete" in output
    assert main([*arguments, "--results", str(made[0] / "records")]) == 0
    assert "run-diagonal-seed0: completed" in capsys.readouterr().out


def test_dry_run_estimates_no_time_from_failed_runs(copied, capsys):
    arguments = [str(write_spec(copied)), "--root", str(copied), "--results", str(copied / "records"), "--dry-run"]
    record = copied / "records" / "run-diagonal-seed0"
    write_record(record, replace(load_record(record), failure="too large"))
    shutil.rmtree(copied / "records" / "run-diagonal-seed1")
    assert main(arguments) == 0
    assert "unknown until a run is complete" in capsys.readouterr().out


def test_command_refuses_an_invalid_sweep(tmp_path, capsys):
    assert main([str(tmp_path / "missing.yaml")]) == 2
    assert "missing.yaml is missing" in capsys.readouterr().err


def test_command_refuses_a_malformed_parameter(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main([str(write_spec(tmp_path)), "--set", "comment=["])
    assert "--set: comment is malformed" in capsys.readouterr().err
