"""The verbs ``sysid train``, ``track`` and ``run``: entry points of the group ``sysid.verbs`` (:mod:`sysid.cli.verbs`)."""

from sysid.cli.verbs import Verb

TRAIN = Verb("sysid_rl.cli.train:train", "Train a policy on a fitted plant.", after="export")
TRACK = Verb("sysid_rl.cli.track:track", "Follow a path with a policy, or with inverse kinematics.", after="train")
RUN = Verb("sysid_rl.cli.run:run", "Run a task on a machine: supervised, recorded, stoppable.", after="track")
