"""Campaign file (TOML): several campaigns with one report; shipped files are named `pack:NAME`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from liftgate_hil.campaigns.folder import OWN
from liftgate_hil.campaigns.request import METHODS, CampaignRequest
from liftgate_hil.campaigns.space import COVARIANCE
from liftgate_hil.config.described import Field, Record, fields_of, read_record
from liftgate_hil.config.kinds import Choice, Raw, Text, Texts, Whole
from liftgate_hil.config.shipped import CAMPAIGNS, PACK, data_root, shipped_names
from liftgate_hil.config.toml import Table, check_kind, read_toml, show, table
from liftgate_hil.errors import ConfigError, ConfigIssues

_FOLDER = f"configs/{CAMPAIGNS}"

# fmt: off
# A field with its key is a row of a table.


class CampaignTable(Record):
    """Top-level keys of a campaign file."""

    title: Annotated[str, Field(Text(), "title of the report")] = ""
    description: Annotated[str, Field(Text(), "what it is about")] = ""
    part: Annotated[Any, Field(Raw("[[part]] tables"), "the campaigns")] = ()


class PartTable(Record):
    """Keys of one campaign ([[part]]) in a campaign file, named like the command's flags."""

    name: Annotated[str, Field(Text(), "its folder in the output")]
    scenario: Annotated[str, Field(Text(), "scenario file, relative to this file, or a shipped name")]
    title: Annotated[str, Field(Text(), "title of its section")] = ""
    vary: Annotated[tuple[str, ...], Field(Texts("a list of texts"), "what is varied, as `--vary`")] = ()
    samples: Annotated[int, Field(Whole(0, 10**9), "as `--samples`")] = 0
    method: Annotated[str, Field(Choice(METHODS), "as `--method`")] = "sobol"


# fmt: on


@dataclass(frozen=True)
class NamedCampaign:
    """Campaign of a campaign file: its name, title and request."""

    name: str
    title: str
    request: CampaignRequest


@dataclass(frozen=True)
class CampaignFile:
    """Content of a campaign file: several campaigns with one report."""

    path: Path
    title: str
    description: str
    parts: tuple[NamedCampaign, ...]


def is_campaign_file(name: str) -> bool:
    """Whether a name begins with `pack:`, is a shipped campaign's, or is a TOML file's that has [[part]]."""
    if name.startswith(PACK) or _lacks_pack_prefix(name):  # the latter is refused with the whole name
        return True
    path = Path(name)
    if path.suffix != ".toml" or not path.is_file():
        return False
    try:
        return "part" in read_toml(path)
    except ConfigError:
        return False  # which is reported for the scenario that it should be


def read_campaign_file(name: str, template: CampaignRequest) -> CampaignFile:
    """Read a campaign file; `template` holds the command's flags, which apply to all parts.

    The template's samples, if any, and its varied names replace those of the parts. Raises ConfigError.
    """
    path = _path_of(name)
    issues = ConfigIssues(str(path))
    content = read_toml(path)
    check_kind(path, content, "campaign", [key.name for key in fields_of(CampaignTable)])
    given = read_record(issues, "", content, CampaignTable)
    if not isinstance(given.part, list | tuple) or not given.part:
        issues.add("part", f"{show(given.part)}; allowed: [[part]] tables")
    issues.raise_if_any()
    parts = [_part_of(path, issues, f"part[{k}]", each, template) for k, each in enumerate(given.part)]
    names = [each.name for each in parts]
    for each in sorted({name for name in names if names.count(name) > 1}):
        issues.add("part", f"{each}: two parts with this name; allowed: each name once")
    issues.raise_if_any()
    unused = [text for text in template.vary if not any(text in each.request.vary for each in parts)]
    if unused:
        raise ConfigError([f"`vary` {text}: allowed: names that a part of {path} varies" for text in unused])
    return CampaignFile(path, given.title or path.stem, given.description, tuple(parts))


def _lacks_pack_prefix(name: str) -> bool:
    """Whether a name is that of a shipped campaign without `pack:`, or with `pack/` in front."""
    return name.removeprefix(PACK.replace(":", "/")) in shipped_names(_FOLDER)


def _path_of(name: str) -> Path:
    if not name.startswith(PACK) and not _lacks_pack_prefix(name):
        return Path(name)
    own = name.removeprefix(PACK)
    known = shipped_names(_FOLDER)
    if own == name or own not in known:
        raise ConfigError(f"`scenario` {name}: allowed: {', '.join(f'{PACK}{each}' for each in known)}")
    return data_root() / _FOLDER / f"{own}.toml"


def _part_of(path: Path, issues: ConfigIssues, key: str, content: Any, template: CampaignRequest) -> NamedCampaign:
    own: Table = table(issues, key, content)
    part = read_record(issues, key, own, PartTable)
    if part.name and (Path(part.name).name != part.name or part.name.startswith(".")):
        issues.add(f"{key}.name", f"{show(part.name)}; allowed: a name of a folder")
    if part.name.casefold() in map(str.casefold, OWN):
        issues.add(f"{key}.name", f"{show(part.name)}: a campaign's own file; allowed: another name")
    beside = path.parent / part.scenario
    # What is given in place of what the file varies of the same name.
    given = {_varied_name(each): each for each in reversed(template.vary)}
    vary = tuple(given.get(_varied_name(each), each) for each in part.vary)
    has_samples = any("~" in each or each.strip() == COVARIANCE for each in vary)
    samples = (template.samples or part.samples) if has_samples else 0
    request = template.replaced(
        scenario=str(beside) if part.scenario and beside.is_file() else part.scenario,
        vary=vary,
        samples=samples or None,
        method=template.method or part.method,
    )
    return NamedCampaign(part.name, part.title or part.name, request)


def _varied_name(text: str) -> str:
    return text.replace("~", "=").partition("=")[0].strip()
