"""``pump_flow_limit``: several axes demand more flow than the pump delivers, and all slow down by one factor."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

#: More than any number of axes demands: the effect is absent.
ABSENT = 100.0

EFFECT = Effect(
    name="pump_flow_limit",
    title="Pump flow limit",
    titles={"unknown": "Shared speed limit"},
    sentences=("The pump feeds at most {limit} full-speed axes at once.",),
    sentences_by={"unknown": ("The axes share a supply that feeds at most {limit} full-speed axes at once.",)},
    part="pump",
    stage="command",
    target="machine",
    slots=(Slot("limit", ABSENT),),
    forms=(
        Form((Parameter("limit", "1", (0.2, ABSENT), (0.8, 1.3, 2.0), 0.02, "sum of |speed|/gain that the pump can feed"),)),
    ),
    equation="all speeds · min(1, limit / Σ |speed|/gain)",
    source="flow balance of a pump at its displacement; 50–70 % of the summed demand (machine facts)",
    excited_by="several axes at large commands at the same time, and each alone",
    confused_with={
        "flow_saturation": "saturation limits an axis that moves alone; a pump only several axes together",
        "gain_error": "a gain error acts at all times; a pump limit only while other axes move",
    },
    example={"limit": 1.0},
    need=Need("together", 5, "Record pairs of axes at full command together, and each of them alone, 5 s each."),
)


@inlined
def share(demand, p, i):
    """Factor on every speed for a summed ``demand``."""
    return p[i] / demand if demand > p[i] else 1.0
