"""A registry on a shared MLflow server: each change takes several requests, which a journal makes atomic.

The change is written to the workspace's journal before the first request and removed after the last. If the process is killed
in between, the next command of this workspace that uses the registry completes it. Each request is idempotent.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from sysid.errors import StoreError
from sysid.names import is_name
from sysid.parse import parse_json
from sysid.registry.client import disk_errors, exclusive, mlflow_errors, open_client
from sysid.registry.stored import CHANGE, DIGEST, ChangeBuilder, ModelChange, StoredModel, StoredVersion
from sysid.root import Root

_PAGE = 1000


class ServerTables:
    """The models at ``uri``, read and changed as those of :class:`sysid.registry.tables.WorkspaceTables`.

    Args:
        workspace: holds the journal, and the lock for the processes of this workspace.
    """

    seals_aliases = False  # all users of the server may set them

    def __init__(self, workspace: Path, uri: str, wait_s: float) -> None:
        self._workspace, self._uri, self._wait_s = workspace, uri, wait_s
        self._root, self.journal = Root(workspace), f"registry-{hashlib.sha256(uri.encode()).hexdigest()[:8]}.journal"

    @functools.cached_property
    def client(self) -> Any:
        return open_client(self._uri)

    def model(self, name: str) -> StoredModel:
        self._finish()
        with mlflow_errors(self._uri):
            return self._model(name)

    def models(self) -> tuple[StoredModel, ...]:
        self._finish()
        with mlflow_errors(self._uri):
            names = sorted(model.name for model in self._all(self.client.search_registered_models))
            return tuple(self._model(name) for name in names)

    def change(self, name: str, build: ChangeBuilder) -> StoredModel:
        _ = self.client  # before the lock: the import takes seconds, an unreachable server longer
        with exclusive(self._workspace, self._wait_s):
            self._finish_locked()
            with mlflow_errors(self._uri):
                before = self._model(name)
            change = build(before)
            if change is None:
                return before
            text = json.dumps({"uri": self._uri, "name": name, "change": CHANGE.dump_python(change, mode="json")})
            with disk_errors(self._workspace):
                self._root.write(self.journal, text.encode("utf-8"))
            with mlflow_errors(self._uri):
                self._carry_out(name, change)
            self._root.remove(self.journal)
            with mlflow_errors(self._uri):
                return self._model(name)

    def _finish(self) -> None:
        if self._root.kind(self.journal) is not None:
            with exclusive(self._workspace, self._wait_s):
                self._finish_locked()

    def _finish_locked(self) -> None:
        """Complete the journalled change of a killed process."""
        try:
            values = parse_json(self._root.read(self.journal))
            name, change = str(values["name"]), CHANGE.validate_python(values["change"])
        except FileNotFoundError:
            return
        except (OSError, LookupError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
            found = f"not readable ({type(error).__name__}: {error})"
            remedy = "Delete it, and repeat the last registration or promotion."
            raise StoreError(self._workspace / self.journal, found, "what sysid wrote", remedy) from None
        with mlflow_errors(self._uri):
            self._carry_out(name, change)
        self._root.remove(self.journal)

    def _carry_out(self, name: str, change: ModelChange) -> None:
        client, new = self.client, change.new
        number = {} if new is None else {new.number: self._added(name, new, change.run)}
        for version, tags in change.version_tags.items():
            for key, value in tags.items():
                if value is not None:
                    client.set_model_version_tag(name, str(version), key, value)
        for alias, target in change.aliases.items():
            if target is not None:
                client.set_registered_model_alias(name, alias, str(number.get(target, target)))
            else:
                client.delete_registered_model_alias(name, alias)  # also where there is none

    def _added(self, name: str, new: StoredVersion, run: str | None) -> int:
        """The number of the version on the server, which differs from the expected one if another workspace took that."""
        from mlflow.exceptions import MlflowException

        try:
            self.client.create_registered_model(name)
        except MlflowException as error:
            if error.error_code != "RESOURCE_ALREADY_EXISTS":
                raise
        there = [version.number for version in self._model(name).own if version.tags[DIGEST] == new.tags[DIGEST]]
        if there:
            return there[0]
        return int(self.client.create_model_version(name, new.source, run_id=run, tags=dict(new.tags)).version)

    def _all(self, search: Callable[..., Any], *what: str) -> Iterator[Any]:
        """What a search finds, page after page."""
        token = None
        while True:
            page = search(*what, max_results=_PAGE, page_token=token)
            yield from page
            token = page.token
            if not token:
                return

    def _model(self, name: str) -> StoredModel:
        if not is_name(name):  # of another program; not safe in a query
            return StoredModel(name)
        versions = [
            StoredVersion(int(entry.version), int(entry.creation_timestamp), str(entry.source), dict(entry.tags))
            for entry in self._all(self.client.search_model_versions, f"name='{name}'")
        ]
        versions.sort(key=lambda version: version.number)
        if not versions:
            return StoredModel(name)
        # The search leaves out aliases (mlflow/mlflow#16734).
        model = self.client.get_registered_model(name)
        aliases = {alias: int(number) for alias, number in dict(model.aliases).items()}
        return StoredModel(name, tuple(versions), aliases, dict(model.tags), versions[-1].number)
