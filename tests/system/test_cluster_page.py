"""Files of docs/cluster.md: the script runs with stand-ins for SLURM, and the manifests are consistent."""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
import readme
import yaml
from hil_support import wait_for

from liftgate_hil.cli import campaign as command

PAGE = readme.ROOT / "docs" / "cluster.md"
# `srun` starts the command that follows its own flags, once; `scontrol` notes how it was called.
SRUN = """#!/bin/bash
while [[ $1 == -* ]]; do shift; done
exec "$@"
"""
SCONTROL = '#!/bin/bash\necho "$@" > "$HOME/scontrol.txt"\n'


def script() -> str:
    (found,) = [each.text for each in readme.blocks(PAGE) if each.text.startswith("#!/bin/bash")]
    return found


def manifests() -> list[dict[str, Any]]:
    texts = [each.text for each in readme.blocks(PAGE) if each.kind == "yaml"]
    return [each for text in texts for each in yaml.safe_load_all(text)]


@pytest.fixture
def job(tmp_path: Path) -> Path:
    """Folder of a job with the page's script for a few variants, and a home with its environment."""
    home = tmp_path / "home"
    (home / "bin").mkdir(parents=True)
    (home / "liftgate/bin").mkdir(parents=True)
    (home / "liftgate/bin/activate").write_text(f'PATH="{home}/bin:{readme.BIN}:$PATH"\n')
    for name, text in (("srun", SRUN), ("scontrol", SCONTROL)):
        (home / "bin" / name).write_text(text)
        (home / "bin" / name).chmod(0o755)
    folder = tmp_path / "job"
    folder.mkdir()
    (folder / "trap.toml").write_bytes((readme.ROOT / "docs/examples/trap.toml").read_bytes())
    text = script()
    assert "--samples 100000" in text
    (folder / "trap.sbatch").write_text(text.replace("--samples 100000", "--samples 40"))
    return folder


def begun(folder: Path) -> subprocess.Popen[bytes]:
    environment = {**readme.environment(folder.parent / "home"), "SLURM_JOB_ID": "7", "SLURM_NNODES": "1"}
    return subprocess.Popen(["bash", "trap.sbatch"], cwd=folder, env=environment, start_new_session=True)


def test_the_slurm_script_resumes_after_its_time_limit(job: Path) -> None:
    """Twice a scheduler, a worker and a client, as processes: some 20 s of CPU time."""
    process = begun(job)
    manifest = job / "trap" / "campaign.json"
    try:
        wait_for(lambda: manifest.exists() or process.poll() is not None, patience=readme.PATIENCE)
        assert process.poll() is None
        os.kill(process.pid, signal.SIGTERM)  # as SLURM does: the script alone
        assert process.wait(readme.PATIENCE) == 143
        assert (job.parent / "home/scontrol.txt").read_text().split() == ["requeue", "7"]
        assert not json.loads(manifest.read_text())["is_complete"]
        process = begun(job)
        assert process.wait(readme.PATIENCE) == 0
        found = json.loads(manifest.read_text())
        assert found["is_complete"]
        assert found["variants"] == 9 * 40
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def test_the_kubernetes_manifests_are_consistent() -> None:
    found = {(each["kind"], each["metadata"]["name"]): each for each in manifests()}
    service = found["Service", "dask-scheduler"]["spec"]
    pods = {name: found["Deployment", name]["spec"]["template"] for name in ("dask-scheduler", "dask-worker")}
    pods["trap"] = found["Job", "trap"]["spec"]["template"]
    assert service["selector"] == pods["dask-scheduler"]["metadata"]["labels"]
    containers = {name: pod["spec"]["containers"][0] for name, pod in pods.items()}
    assert len({each["image"] for each in containers.values()}) == 1
    port = service["ports"][0]["port"]
    assert containers["dask-scheduler"]["command"][:4] == ["dask", "scheduler", "--port", str(port)]
    address = f"tcp://dask-scheduler:{port}"
    assert address in containers["dask-worker"]["command"]
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    args = parser.parse_args(containers["trap"]["args"][1:])
    assert (args.scheduler, args.resume) == (address, True)
    places = {each["name"]: each["mountPath"] for each in containers["trap"]["volumeMounts"]}
    volumes = {each["name"]: each for each in pods["trap"]["spec"]["volumes"]}
    assert places.keys() == volumes.keys()
    assert args.scenario.startswith(places["scenario"])
    assert args.output.startswith(places["results"])
    assert ("PersistentVolumeClaim", volumes["results"]["persistentVolumeClaim"]["claimName"]) in found
    maps = re.findall(r"kubectl create configmap (\w+)", PAGE.read_text(encoding="utf-8"))
    assert maps == [volumes["scenario"]["configMap"]["name"]]
