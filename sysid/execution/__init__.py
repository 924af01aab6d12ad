"""Where independent tasks run: in this process, in processes of this machine, or on an existing cluster.

Every task is a module-level function of plain values (text, numbers): the location of a workspace and references into it.
Tables are read where the task runs, results are JSON values. The same tasks give the same results everywhere.
"""

from sysid.execution.choice import open_executor
from sysid.execution.executor import Executor, TaskError
from sysid.execution.local import LocalExecutor

__all__ = ["Executor", "LocalExecutor", "TaskError", "open_executor"]
