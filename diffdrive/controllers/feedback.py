"""Which encoder each loop of a cascade is closed over: two words of [controller]."""

from diffdrive.controllers.kinds import Option, Section
from diffdrive.model.parameters import Drive
from diffdrive.support.messages import short_repr

ENCODERS = ("scale", "motor")
FEEDBACK = ("position_feedback", "velocity_feedback")
FEEDBACK_OPTIONS = tuple(
    Option(name, "", "scale, motor", "scale", f"encoder of the {name.split('_')[0]} loop; motor needs [motor_encoder]")
    for name in FEEDBACK
)


def feedback_problem(encoder: object) -> str | None:
    """Why a loop cannot be closed over this encoder; None where it can."""
    return None if encoder in ENCODERS else f'must be "scale" or "motor", got {short_repr(encoder)}'


def read_feedback(section: Section, drive: Drive) -> dict[str, object]:
    """The encoders of both loops; one that the drive has not is an error."""
    feedback = {name: section.take(name, "scale") for name in FEEDBACK}
    for name, encoder in feedback.items():
        problem = feedback_problem(encoder)
        if problem is None and encoder == "motor" and drive.motor_encoder is None:
            problem = 'is "motor", and the file has no table [motor_encoder]: state that encoder, or use "scale"'
        if problem is not None:
            raise section.fail(name, problem)
    return feedback
