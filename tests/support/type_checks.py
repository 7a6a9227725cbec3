"""A plugin that checks the type hints of `diffdrive` at run time: `python -m pytest -p tests.support.type_checks`."""

from beartype import BeartypeConf, beartype
from jaxtyping import install_import_hook

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))  # an int is a float, as for every type checker

install_import_hook("diffdrive", "tests.support.type_checks.checked")
