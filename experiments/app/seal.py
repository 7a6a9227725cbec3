"""The seal of a job: this user's app made it, in this folder.

A job begins by itself when the app starts. A folder may be a colleague's: nobody here has asked for what its jobs hold.
"""

import hashlib
import hmac
import json
from collections.abc import Sequence

from experiments.app.job import Job


class Seal:
    """Seals command lines with a secret that no folder holds."""

    def __init__(self, secret: bytes) -> None:
        self._secret = secret

    def of(self, job: Job, arguments: Sequence[str]) -> str:
        """The seal of a command line in the folder of a job: in a copy of the folder it does not hold."""
        text = json.dumps([str(job.folder), *arguments])
        return hmac.new(self._secret, text.encode(), hashlib.sha256).hexdigest()

    def holds(self, job: Job) -> bool:
        """Whether the command line of a job is the one that was sealed."""
        kept = str(job.record.get("seal", ""))
        return hmac.compare_digest(kept.encode(), self.of(job, job.arguments).encode())
