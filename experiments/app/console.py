"""What a command printed: stages and how far each is, sentences, the one line of an error; never a traceback."""

import re
from dataclasses import dataclass, field
from pathlib import Path

BEGIN = "$ diffdrive "  # of the line that opens each run in the log
MOST = 400_000  # bytes of a log's end that are read: some thousand lines, beyond which nobody scrolls
TRACEBACK = "Traceback (most recent call last)"
_STAGE = re.compile(r"(?P<stage>\S.*): (?P<done>\d+) of (?P<most>\d+), (?P<seconds>\d+) s")
_ERROR = re.compile(r"error: (?P<text>.+)")
_BOX = re.compile(r"│\s*(?P<text>.*?)\s*│")  # of a misspelt option
_LAST_WORDS = re.compile(r"interrupted, .+")


@dataclass
class Stage:
    """A stage of a command: how many of its parts are done, and whether another has begun since."""

    name: str
    done: int
    most: int
    seconds: int
    is_over: bool = False

    @property
    def share(self) -> float:
        """From 0 to 1."""
        return 1.0 if self.is_over else self.done / self.most if self.most else 0.0


@dataclass
class LogText:
    """The log of the last run; `text` is free of tracebacks, `error` the one line that says why it was refused."""

    text: str = ""
    stages: list[Stage] = field(default_factory=list)
    error: str = ""
    last_words: str = ""
    failed: bool = False


def read_console(path: Path) -> LogText:
    """Take the log of a job apart."""
    try:
        with path.open("rb") as file:
            file.seek(0, 2)
            file.seek(max(0, file.tell() - MOST))
            text = file.read().decode("utf-8", "replace")
    except OSError:
        return LogText()
    return parse_console(text)


def parse_console(text: str) -> LogText:
    """The parts of what was printed since the last run began."""
    begin = text.rfind(BEGIN)
    lines = (text[begin:] if begin >= 0 else text).replace("\r\n", "\n").split("\n")
    found = LogText()
    kept: list[str] = []
    box: list[str] = []
    for line in lines:
        if TRACEBACK in line:
            found.failed = True
            break
        kept.append(line)
        if stage := _STAGE.fullmatch(line.strip()):
            _advance(found.stages, stage["stage"], int(stage["done"]), int(stage["most"]), int(stage["seconds"]))
        elif error := _ERROR.fullmatch(line.strip()):
            found.error = error["text"]
        elif boxed := _BOX.fullmatch(line.strip()):
            box.append(boxed["text"])
        elif words := _LAST_WORDS.fullmatch(line.strip()):
            found.last_words = words[0]
    found.text = "\n".join(kept).strip()
    found.error = found.error or " ".join(box)
    return found


def _advance(stages: list[Stage], name: str, done: int, most: int, seconds: int) -> None:
    for stage in stages:
        if stage.name == name and stage is stages[-1]:
            stage.done, stage.most, stage.seconds = done, most, seconds
            return
    for stage in stages:
        stage.is_over = True
    stages[:] = [stage for stage in stages if stage.name != name]  # one that comes again is shown once, as the last
    stages.append(Stage(name, done, most, seconds))
