"""``sensor_quantisation``: readings are whole steps of a counter or converter."""

import numpy as np

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="sensor_quantisation",
    title="Sensor resolution",
    sentences=("The sensor {target} moves in steps of {step}.",),
    part="sensor",
    stage="sensor",
    target="signal",
    slots=(Slot("step"),),
    forms=(Form((Parameter("step", "signal", (0.0, 0.1), (1e-4, 1e-3, 1e-2), 2e-5, "between two readings", stepwise=True),)),),
    equation="measured = step·⌊true/step + ½⌋",
    source="Widrow & Kollár, Quantization Noise, 2008, ch. 1; 0.01 mm on draw wires (machine facts)",
    excited_by="slow motion that resolves single steps",
    confused_with={
        "stiction": "with quantisation one reading is constant while other sensors move; stiction stops the motion itself",
        "backlash": "quantisation has steps at fixed readings; backlash a standstill at each reversal",
    },
    example={"step": 0.05},
    fitted=False,
    need=Need("signal_travel", 10, "Record {axis} creeping over several of its sensor's steps."),
)


@inlined
def step(x, p, i):
    return p[i] * np.floor(x / p[i] + 0.5) if p[i] > 0.0 else x
