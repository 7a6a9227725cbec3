"""Names that every target takes: letters, digits and single underscores, no word of a language."""

import re
from collections.abc import Iterable, Sequence

from diffdrive.errors import ParameterError
from diffdrive.support.messages import short_repr

LONGEST = 24  # some controllers end names at 32 characters
C_WORDS = """auto break case char const continue default do double else enum extern float for goto if inline int long
register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while main
asm catch class delete explicit export friend mutable namespace new operator private protected public template this
throw try typeid typename using virtual"""  # and those of C++, in which the header may be included
# IEC 61131-3 with its instruction list, CODESYS and TwinCAT ("Keywords", error C0543), standard functions and blocks
ST_WORDS = """abs abstract acos action add adr and andn array asin at atan atan2 bitadr bool by byte cal calc calcn char
class concat configuration constant cos ctd ctu ctud date delete dint div do dt dword else elsif en end eno eq exit exp
expt extends f_edge f_trig false final find for from function ge gt if implements indexof insert int interface internal
interval jmp jmpc jmpcn ld ldate ldn ldt le left len limit lint ln log lreal lt ltime ltod lword max method mid min mod
move mul mux namespace ne not of on or orn override params persistent pointer port private program property protected
public r r_edge r_trig read_only read_write real ref reference repeat replace resource ret retain retc retcn return
right rol ror rs rtc s sel shl shr sin single sint sizeof sqrt sr st step stn string struct sub super tan task then this
time to tod tof ton tp transition true trunc type udint uint ulint until usint var wchar while with word wstring xor
xorn"""
# variables beside the block, in its bench
BENCH_WORDS = "controller sample largest off difference no_number deviation done passed"
RESERVED = frozenset((C_WORDS + " " + ST_WORDS).split())
DEVICES = frozenset({"con", "prn", "aux", "nul", *(f"{port}{k}" for port in ("com", "lpt") for k in range(10))})
# no name of a controller: its files have it, and Windows makes none that is called as a device
TAKEN = RESERVED | frozenset(BENCH_WORDS.split()) | DEVICES
OWN_WORDS = """restart reset initialised start_position update_parameters period wrong_period refused not_a_number
i in out k s p none"""
OWN = frozenset(OWN_WORDS.split())
OWN_PATTERN = re.compile(r"[tpbc]\d+|(k|s|next|first|run)_.*")


def checked_name(name: str) -> str:
    """The name unchanged; raises `ParameterError` for one that some target does not take."""
    if not re.fullmatch(r"[A-Za-z](_?[A-Za-z0-9])*", name) or len(name) > LONGEST or name.lower() in TAKEN:
        raise ParameterError(
            f"name {short_repr(name)}: must be a letter, then letters, digits and single underscores, at most "
            f"{LONGEST} in all, and no word of C, of Structured Text, of the bench or of Windows"
        )
    return name


def name_of(text: str) -> str:
    """A name that is like some text, such as that of an axis."""
    words = re.findall(r"[a-z0-9]+", text.lower())
    name = "_".join(words)[:LONGEST].strip("_") or "axis"
    if not name[0].isalpha() or name in TAKEN:
        name = f"axis_{name}"[:LONGEST].strip("_")
    return name


def ends_of(paths: Sequence[str]) -> list[str]:
    """The end of each dotted path that no other has, of two parts or more."""
    split = [path.split(".") for path in paths]
    ends = []
    for parts in split:
        count = 2
        while sum(other[-count:] == parts[-count:] for other in split) > 1 and count < len(parts):
            count += 1
        ends.append(".".join(parts[-count:]))
    return ends


def identifiers(paths: Iterable[str], taken: Iterable[str] = ()) -> list[str]:
    """A name for each path, none twice, none of a language, of the code's own, or in `taken`; case does not tell."""
    used = {one.lower() for one in taken} | RESERVED | OWN
    names = []
    for path in paths:
        words = "".join(letter if letter.isascii() and letter.isalnum() else " " for letter in path).split()
        stem = "_".join(words) or "memory"
        if not stem[0].isalpha() or stem.lower() in RESERVED | OWN or OWN_PATTERN.fullmatch(stem.lower()):
            stem = f"n{stem}"  # none of those words begins with an n and goes on as another
        name, count = stem, 1
        while name.lower() in used:
            count += 1
            name = f"{stem}_{count}"
        used.add(name.lower())
        names.append(name)
    return names
