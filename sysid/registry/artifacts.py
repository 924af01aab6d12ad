"""Storage of model files: a content-addressed folder of the workspace, or the artifact store of an MLflow server."""

from __future__ import annotations

import tempfile
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sysid.errors import StoreError
from sysid.registry.stored import RECORDS, Record, read_records, with_record
from sysid.registry.version import MANIFEST, sha256
from sysid.root import Root

_PARTIAL = ".partial-"
#: MLflow experiment of the runs that hold model files.
_EXPERIMENT = "sysid"


@dataclass(frozen=True)
class FolderArtifacts:
    """``<folder>/<digest>/<file>``; found by digest, so that a workspace may be moved. Both methods are idempotent."""

    folder: Path

    def write(self, digest: str, files: Mapping[str, bytes], manifest: str, record: Record) -> tuple[str, str | None]:
        """Store all files or none; returns (source URI, MLflow run id or None). A damaged file is replaced.

        They are written to a temporary folder that is synced and renamed. Requires the registry's lock: other temporary folders
        are then of killed processes, and are removed.

        Args:
            record: the row of the registry, stored so that a lost registry can be rebuilt.
        """
        root, models = Root(self.folder.parent), self.folder.name
        target = f"{models}/{digest}"
        root.make(models)
        for dead in root.entries(models):
            if dead.startswith(_PARTIAL):
                root.remove(f"{models}/{dead}")
        records = with_record(read_records(root, target), record)
        contents = {**files, MANIFEST: manifest.encode("utf-8"), RECORDS: records}
        wrong = {name: content for name, content in contents.items() if not _holds(root, f"{target}/{name}", content)}
        if wrong:
            partial = f"{models}/{_PARTIAL}{uuid.uuid4().hex}"
            try:
                for name, content in wrong.items():
                    root.write_new(f"{partial}/{name}", content)
                if root.kind(target) is not None:
                    for name in wrong:
                        root.rename(f"{partial}/{name}", f"{target}/{name}")
                else:
                    root.sync(partial)
                    root.rename(partial, target)
            finally:
                root.remove(partial)
        return (self.folder / digest).resolve().as_uri(), None

    def read(self, digest: str, source: str, name: str) -> bytes:
        """Content of one file, not yet checked."""
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
    """Files as artifacts of one MLflow run per version, for all users of the server."""

    client: Any
    uri: str

    def write(self, digest: str, files: Mapping[str, bytes], manifest: str, record: Record) -> tuple[str, str | None]:
        """As :meth:`FolderArtifacts.write`, without ``record``: the server stores its own rows."""
        experiment = self.client.get_experiment_by_name(_EXPERIMENT)
        identity = experiment.experiment_id if experiment else self.client.create_experiment(_EXPERIMENT)
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


def _holds(root: Root, path: str, content: bytes) -> bool:
    try:
        return root.read(path) == content
    except OSError:
        return False
