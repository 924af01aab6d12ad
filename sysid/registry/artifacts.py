"""Where the files of a version lie: a content-addressed folder of the workspace, or the artifact store of an MLflow server."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from sysid.errors import StoreError
from sysid.files import on_disk, write_through
from sysid.registry.version import sha256
from sysid.root import Root

MANIFEST = "manifest.json"
_PARTIAL = ".partial-"


class ArtifactStore(Protocol):
    """Keeps the files of one version under its digest; both calls may be repeated without harm."""

    def write(self, digest: str, files: Mapping[str, bytes], manifest: str) -> tuple[str, str | None]:
        """Store all files or none; returns (source URI, MLflow run id or None)."""
        ...

    def read(self, digest: str, source: str, name: str) -> bytes:
        """Content of one file, not yet checked."""
        ...


@dataclass(frozen=True)
class FolderArtifacts:
    """``<folder>/<digest>/<file>``; found by digest, so a workspace may be moved or mounted elsewhere."""

    folder: Path

    def write(self, digest: str, files: Mapping[str, bytes], manifest: str) -> tuple[str, str | None]:
        """Files and folder reach the disk under a temporary name and appear by one rename.

        Only the holder of the registry's lock may call this: a folder under a temporary name is then a dead writer's.
        """
        target = self.folder / digest
        contents = {**files, MANIFEST: manifest.encode("utf-8")}
        Root(self.folder.parent).make(self.folder.name)
        for dead in self.folder.glob(f"{_PARTIAL}*"):
            shutil.rmtree(dead)
        if not _holds(target, contents):
            partial = Path(tempfile.mkdtemp(prefix=_PARTIAL, dir=self.folder))
            try:
                for name, content in contents.items():
                    write_through(partial / name, content)
                on_disk(partial)
                if target.exists():  # damaged: this call brings the true content
                    shutil.rmtree(target)
                partial.rename(target)
            finally:
                shutil.rmtree(partial, ignore_errors=True)
            on_disk(self.folder)
        return target.resolve().as_uri(), None

    def read(self, digest: str, source: str, name: str) -> bytes:
        path = self.folder / digest / name
        try:
            return Root(self.folder.parent).read(f"{self.folder.name}/{digest}/{name}")
        except FileNotFoundError:
            raise StoreError(
                path, "the file is gone", "the file that was registered", "Fit or register the model again."
            ) from None
        except OSError as error:
            raise StoreError(path, f"cannot be read ({error.strerror})", "a readable file") from None


@dataclass(frozen=True)
class RunArtifacts:
    """Files as artifacts of one MLflow run per version, so that everyone who uses that server can load them."""

    client: Any
    uri: str
    experiment: str = "sysid"
    location: str | None = None

    def write(self, digest: str, files: Mapping[str, bytes], manifest: str) -> tuple[str, str | None]:
        experiment = self.client.get_experiment_by_name(self.experiment)
        identity = (
            experiment.experiment_id
            if experiment
            else self.client.create_experiment(self.experiment, artifact_location=self.location)
        )
        run = self.client.create_run(identity, run_name=digest[:12], tags={"sysid.digest": digest})
        with tempfile.TemporaryDirectory() as folder:
            for name, content in {**files, MANIFEST: manifest.encode("utf-8")}.items():
                (Path(folder) / name).write_bytes(content)
            self.client.log_artifacts(run.info.run_id, folder, "model")
        self.client.set_terminated(run.info.run_id)
        return f"{run.info.artifact_uri}/model", str(run.info.run_id)

    def read(self, digest: str, source: str, name: str) -> bytes:
        from mlflow.artifacts import download_artifacts
        from mlflow.exceptions import MlflowException

        with tempfile.TemporaryDirectory() as folder:
            try:
                path = download_artifacts(artifact_uri=f"{source}/{name}", dst_path=folder, tracking_uri=self.uri)
                return Path(path).read_bytes()
            except (MlflowException, OSError) as error:
                message = str(error).splitlines()[0]
                raise StoreError(f"{source}/{name}", f"cannot be read ({message})", "the file that was registered") from None


def checked(content: bytes, expected: str, where: object) -> bytes:
    """``content`` if its sha256 is the registered one.

    Raises:
        StoreError: it was changed or damaged after registration.
    """
    found = sha256(content)
    if found != expected:
        raise StoreError(
            where,
            f"sha256 {found[:12]}…, so the content was changed after registration",
            f"sha256 {expected[:12]}…",
            "Restore the file, or fit and register the model again.",
        )
    return content


def _holds(folder: Path, contents: Mapping[str, bytes]) -> bool:
    try:
        return all((folder / name).read_bytes() == content for name, content in contents.items())
    except OSError:
        return False
