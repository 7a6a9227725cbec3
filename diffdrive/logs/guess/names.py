"""What the name of a column says: the quantity, whether it is a set-point, and of which encoder.

A name is taken apart into the words that it is made of: at its signs and capitals, and compounds such as
`Lageistwert` or `actpos` into words of the list. What is not made of the list's words altogether says nothing.
"""

import re
from functools import cache
from typing import Literal, NamedTuple, cast

Quantity = Literal["time", "index", "position", "velocity", "force", "current", "load", "temperature", "error", "other"]
Role = Literal["set", "actual", "feedforward"]
Encoder = Literal["motor", "scale"]


class Words(NamedTuple):
    """What a name says; None where it does not."""

    quantity: Quantity | None = None
    role: Role | None = None
    encoder: Encoder | None = None


# English, German and French, as controls and engineers write them; short ones count only where they stand alone
_QUANTITIES: dict[Quantity, str] = {
    "time": "time zeit temps t timestamp clock zeitstempel uhrzeit secs seconds",
    "index": "index sample samples row nr no number count cycle nummer zeile",
    "position": "position positions pos posn lage weg angle winkel travel encoder enc geber abscissa s q "
    "massstab linearmassstab glassmassstab glasmassstab messsystem",
    "velocity": "velocity vel velo vitesse speed geschwindigkeit geschw drehzahl rpm v n",
    "force": "force kraft torque trq moment drehmoment mom couple effort thrust schub md m f u output stellgroesse "
    "stellgrösse pwm",
    "current": "current curr strom courant i iq isq amps",
    "load": "load last auslastung utilisation utilization charge",
    "temperature": "temperature temp temperatur",
    "error": "error err deviation dev lag schlepp schleppabstand schleppfehler fehler abweichung following "
    "diff "
    "difference differenz regelabweichung ecart écart contour",
    "other": "acceleration acc accel beschleunigung jerk ruck power leistung voltage volt spannung tension uq ud id "
    "limit grenze status flag activated override pressure druck "
    "integral",
}
_ROLES: dict[Role, str] = {
    "set": "set setpoint setp soll sollwert nominal nom cmd command commanded ref reference target desired demand "
    "demanded des consigne interpolated sp",
    "actual": "act actual actl ist istwert fb fbk feedback meas measured measure mes mesure mesuré gemessen real",
    "feedforward": "ff feedforward vorsteuerung vorsteuer precontrol",
}
_ENCODERS: dict[Encoder, str] = {
    "motor": "motor mot rotor indirect indirekt motorseitig 1st first",
    "scale": "scale linear table direct direkt tisch massstab linearmassstab glassmassstab glasmassstab lastseitig "
    "2nd second glass",
}
_SILENT = (
    "wert value val values signal sig axis achse axe nck servo data drive contr control controller joint pid axes "
    "x y z "
    "a b c f d g k w 1 2 3 4 5 6 7 8 16 32 64 lreal in out of the de generating momentenbildend momentbildend"
)
_LINKS = ("", "s", "en", "n", "er", "e")  # between the words of a German compound
_SHORTEST = 3  # letters of a word within a compound: shorter ones are found in any name
_PARTS = re.compile(r"\d+(?:st|nd)(?![a-z])|[A-ZÄÖÜ]+(?![a-zäöüéß])|[A-ZÄÖÜ]?[a-zäöüéß]+|\d+")


def _facets() -> dict[str, list[tuple[str, str]]]:
    found: dict[str, list[tuple[str, str]]] = {word: [] for word in _SILENT.split()}
    for facet, words in (("quantity", _QUANTITIES), ("role", _ROLES), ("encoder", _ENCODERS)):
        for meaning, listed in words.items():
            for word in listed.split():
                found.setdefault(word, []).append((facet, meaning))
    return found


_VOCABULARY = _facets()


@cache
def words_of(name: str) -> Words:
    """What a column's name says, its unit taken off.

    Examples:
        >>> words_of("nckServoDataActPos1stEnc64 [u1, 1]")
        >>> words_of("Momentensollwert")

    """
    said: dict[str, list[str]] = {"quantity": [], "role": [], "encoder": []}
    parts = [part.casefold() for part in _PARTS.findall(re.sub(r"\[[^\]]*\]", "", name))]
    for part in parts:
        for word in [part] if part in _VOCABULARY else _compound(part) or ():
            for facet, meaning in _VOCABULARY[word]:
                said[facet].append(meaning)
    quantities = said["quantity"]
    quantity: str | None = next((one for one in ("error", "other") if one in quantities), None)
    if quantity is None and quantities:
        # "current position" is the present one, "load position" that on the side of the load, and
        # "torque generating current" is a current
        ranked = ("time", "position", "velocity", "current")
        quantity = next((one for one in ranked if one in quantities), quantities[0])
    if quantity is None and parts in (["command"], ["cmd"]):
        quantity = "force"  # by itself it is what the controller gives
    roles: tuple[Role, ...] = ("feedforward", "set", "actual")
    role = next((one for one in roles if one in said["role"]), None)
    encoder = said["encoder"][0] if len(set(said["encoder"])) == 1 else None
    if quantity == "position" and "load" in quantities:
        encoder = encoder or "scale"
    return Words(cast(Quantity | None, quantity), role, cast(Encoder | None, encoder))


def _compound(part: str) -> list[str] | None:
    """The words that a part is made of altogether, the longest first; None where it is not."""
    for length in range(len(part), _SHORTEST - 1, -1):
        if part[:length] not in _VOCABULARY:
            continue
        rest = part[length:]
        if not rest:
            return [part]
        for link in _LINKS:
            if rest.startswith(link) and (following := _compound(rest[len(link) :])):
                return [part[:length], *following]
    return None
