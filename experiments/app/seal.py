"""The seal of a job or a key: this user's app made it, in this folder.

A job begins by itself when the app starts. A folder may be a colleague's: nobody here has asked for what its jobs hold,
and its key is the colleague's, too.
"""

import hashlib
import hmac
import json
from pathlib import Path


class Seal:
    """Seals texts with a secret that no folder holds."""

    def __init__(self, secret: bytes) -> None:
        self._secret = secret

    def of(self, folder: Path, *texts: str) -> str:
        """The seal of texts that are kept in a folder: in a copy of it, and for other texts, it does not hold."""
        return hmac.new(self._secret, json.dumps([str(folder), *texts]).encode(), hashlib.sha256).hexdigest()

    def holds(self, seal: object, folder: Path, *texts: str) -> bool:
        """Whether a seal that was read from a file is theirs."""
        return hmac.compare_digest(str(seal).encode("utf-8", "replace"), self.of(folder, *texts).encode())
