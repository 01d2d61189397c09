"""Vocabulary of signal, message and label names in databases: English, German and abbreviations."""

from __future__ import annotations

import functools
import re
from collections.abc import Collection, Iterable, Mapping

# Concept: words for it in names. Words of four or more letters may be parts of longer ones; shorter ones, and
# those after "=" (there is a gate in gateway, and a lock in clock), must stand alone.
WORDS: Mapping[str, tuple[str, ...]] = {
    "left": ("left", "links", "l", "le", "li", "lh", "lt", "lhs", "hl", "lft", "lnks"),
    "right": ("right", "rechts", "r", "re", "ri", "rh", "rt", "rhs", "hr", "rgt", "rght"),
    "gate": ("=gate", "klappe", "=heck", "hatch", "trunk", "tailgate", "liftgate", "=lftgt", "hkl", "hk", "ptg",
             "plg", "pltg", "plgm", "tg", "lg", "=ltgt", "=tlgt", "decklid", "=boot", "spindel", "spindle",
             "backdoor", "heckdeckel"),
    "motor": ("motor", "mot", "mtr", "=drive", "drv", "antrieb", "antr", "spindle", "spindel", "actuator", "aktor",
              "drehz"),
    "duty": ("duty", "pwm", "tastv", "tastgrad", "dc", "aussteuer", "stellgr", "=dtycyc", "dty"),
    "direction": ("direction", "dir", "richtung", "=drctn", "=dirn", "bruecke", "bridge", "rtg"),
    "latch": ("latch", "=ltch", "schloss", "riegel", "=lock", "unlock", "locked", "striker", "=unlck",
              "hauptrast"),
    "release": ("release", "unlock", "unlatch", "entrieg", "rls", "rel", "=rlse", "=unlck", "oeffnen"),
    "current": ("current", "curr", "=crnt", "strom", "cur", "i", "amps"),
    "hall": ("hall", "encoder", "enc", "inkrement", "impuls", "imp", "pulse", "pls", "edges"),
    "period": ("period", "periode", "prd"),
    "edge": ("edge", "flanke", "flank"),
    "age": ("=age", "alter", "elapsed"),
    "count": ("count", "cnt", "=cntr", "ctr", "zaehl", "pos", "position", "zlr", "impulse", "pulses"),
    "speed": ("speed", "spd", "drehz", "geschw", "rpm", "velocity", "vel", "n"),
    "position": ("position", "posn", "pos", "turns", "umdr", "weg"),
    "angle": ("angle", "winkel", "ang", "agl", "=angl", "wnkl", "wkl"),
    "voltage": ("voltage", "volt", "spannung", "ubat", "vbat", "kl30", "klemme30", "bordnetz", "u", "v", "vltg",
                "spg", "ub", "versorgung"),
    "temperature": ("temperatur", "temp", "tmp", "te", "t"),
    "ambient": ("ambient", "amb", "aussen", "outside", "outsd", "umgeb", "oat", "exterior"),
    "slope": ("slope", "inclin", "=incl", "neigung", "steigung", "pitch", "=grade"),
    "acceleration": ("accel", "acc", "accl", "beschl"),
    "actual": ("actual", "act", "feedback", "fdbk", "fbk", "ist", "measured", "meas", "istwert"),
    "limit": ("limit", "lim", "max", "min", "thresh", "schwelle", "average", "avg", "sum", "summe", "peak",
              "total", "offset", "error", "fault", "fehler", "valid", "vld", "gueltig", "quality", "qf", "target"),
    "counter": ("alive", "alv", "rolling", "msgcount", "messagecount", "bz", "botschaftsz", "rc", "sqc", "seq",
                "sequence", "ctr", "counter", "cnt", "=cntr", "zaehler", "mc", "arc", "rollg", "lfd"),
    "checksum": ("crc", "checksum", "=chks", "chk", "pruefsumme", "xor", "cs", "chksm", "cksm", "ps"),
    "hand force": ("handkraft", "handforce", "=hndfrc"),
    "handle": ("=griff", "=handle", "aussengriff", "tuergriff"),
    "button": ("button", "taster", "=btn"),
    "pinch strip": ("klemmleiste", "pinchstrip", "klemmschutzleiste", "=strip"),
    "channel a": ("a", "halla"),
    "channel b": ("b", "hallb"),
}  # fmt: skip

# Labels of an enumeration by the name of our value; ambiguous labels are left out.
_OPEN = ("open", "opening", "auf", "oeffnen", "oeffnet", "up", "hoch", "raise", "heben", "opn", "moveopen")
_CLOSE = ("close", "closing", "zu", "schliessen", "schliesst", "down", "runter", "lower", "senken", "cls", "clsng")
_COAST = ("coast", "off", "aus", "frei", "freilauf", "leerlauf", "free", "freewheel", "idle", "float", "inactive",
          "none", "open loop")  # fmt: skip
_BRAKE = ("brake", "braking", "bremse", "bremsen", "brk", "shorted", "halten")
LABELS: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "direction": {"coast": _COAST, "open": _OPEN, "close": _CLOSE, "brake": _BRAKE},
    "latch_release": {
        "hold": ("hold", "off", "idle", "inactive", "none", "no", "ruhe", "aus", "false", "no request",
                 "norequest", "not active", "no action", "keine", "nicht betaetigt", "halten", "locked"),
        "release": ("release", "open", "unlock", "unlatch", "entriegeln", "on", "active", "request", "ein", "true",
                    "yes", "oeffnen", "rls", "freigeben"),
    },
    "switch": {
        "off": ("off", "aus", "no", "nein", "false", "inactive", "released", "not pulled", "nicht gezogen",
                "not pressed", "nicht gedrueckt", "nicht betaetigt", "not actuated"),
        "on": ("on", "ein", "yes", "ja", "true", "active", "pulled", "gezogen", "pressed", "gedrueckt",
               "betaetigt", "actuated"),
    },
    "latch_state": {
        "open": ("open", "offen", "auf", "frei", "released", "unlatched", "unlocked", "entriegelt", "not latched"),
        "latched": ("latched", "closed", "locked", "verriegelt", "zu", "geschlossen", "eingerastet", "gesperrt",
                    "fully latched", "primary", "hauptrast", "hauptraste"),
    },
}  # fmt: skip
_FILLING = {
    "the", "motor", "mot", "mtr", "dir", "direction", "latch", "gate", "state", "status", "sts", "st", "cmd",
    "command", "move", "moving", "bridge", "klappe", "heckklappe", "schloss", "is", "drive", "richtung", "lg",
    "tg", "hkl", "rel", "ltch",
}  # fmt: skip
_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue"})
_MEASURED = {"hall", "current", "motor", "position", "left", "right"}  # not of a message counter
_PREFIX = re.compile(r"(?<![A-Za-z])[lr](?=[A-Z])")  # prefix of a ratio or a length, not of right or left
_PART = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")


@functools.lru_cache(100_000)
def words_of(name: str) -> tuple[str, ...]:
    """Return the words of a name in lower case: MotCurrLH_1 gives mot, curr, lh, 1; rPwmLe, a ratio, pwm, le."""
    plain = _PREFIX.sub("", name.translate(_UMLAUTS))
    return tuple(part.lower() for part in _PART.findall(plain))


@functools.lru_cache(100_000)
def concepts_in(name: str) -> frozenset[str]:
    """Return the concepts (keys of WORDS, such as left or motor) for which a name contains a word."""
    words = words_of(name)
    whole = "".join(words)
    return frozenset(concept for concept, spelled in WORDS.items() if _speaks(spelled, words, whole))


def _speaks(spelled: Iterable[str], words: Collection[str], whole: str) -> bool:
    """Whether a word of `spelled`, as in WORDS, is one of a name's `words`, or, if long, a part of `whole`."""
    return any(
        each.removeprefix("=") in words or (len(each) >= 4 and each[0] != "=" and each in whole)
        for each in spelled
    )


def is_message_counter(concepts: frozenset[str]) -> bool:
    """Whether a signal with these concepts in its name is an alive counter, and no sensor reading."""
    return "counter" in concepts and not concepts & _MEASURED


def side_of(*names: str) -> str:
    """Return "left" or "right" by the first of these names that tells the side; "" if none does."""
    for name in names:
        sides = concepts_in(name) & {"left", "right"}
        if len(sides) == 1:
            return "".join(sides)
    return ""


def named_values(kind: str, choices: Mapping[int, str]) -> dict[str, str]:
    """Return the database's label by the project's value name, for values that exactly one label means."""
    found: dict[str, list[str]] = {}
    for label in dict.fromkeys(choices.values()):
        words = words_of(label)
        spelling = " ".join(each for each in words if each not in _FILLING) or " ".join(words)
        for ours, spelled in LABELS[kind].items():
            if spelling in spelled or spelling.replace(" ", "") in spelled:
                found.setdefault(ours, []).append(label)
    return {ours: labels[0] for ours, labels in found.items() if len(labels) == 1}
