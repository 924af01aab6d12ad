"""The files of an MJCF: its includes put in place, and every other file that it names found and checked before it is opened.

MuJoCo opens whatever path a model names, also a device, a pipe that nobody writes to, or a file of somebody else. Here a file
is opened only where it is a regular file below the folder of the model, or below a folder that the user allows. MuJoCo is
handed the text that was checked, in which each name leads to the file that was found.

Source: MuJoCo 4 documentation, *XML reference* (``include``, ``compiler``: ``meshdir``, ``texturedir``, ``assetdir``,
``strippath``), and its reader ``src/xml/xml.cc``: a name is looked up below the folder of the model, then below that of the
included file that has it.
"""

from __future__ import annotations

import os
import shlex
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.saxutils import quoteattr

from sysid.errors import InputError
from sysid.foreign import MAX_NAME, is_unicode, shown, visible
from sysid.parse import read_xml

#: Nested elements; MuJoCo reads 500.
MAX_DEPTH = 200
#: Models attached inside of each other.
MAX_ATTACHED = 16
#: Attributes of ``compiler`` that say where files are; names in the joined text do not need them.
_FOLDERS = ("assetdir", "meshdir", "texturedir", "strippath")
#: Elements that name a file whose content can be left out where no mass depends on it.
_SHAPES = ("mesh", "hfield", "skin", "texture")
#: Vertices [m] and heights of the stand-ins of a mesh and a height field, by which they are recognised in the specification.
#: They are exact in single precision, and MuJoCo reverses the rows of heights.
_EDGE = 0.01171875
STANDIN_MESH = (0.0, 0.0, 0.0, _EDGE, 0.0, 0.0, 0.0, _EDGE, 0.0, 0.0, 0.0, _EDGE)
STANDIN_HEIGHTS = (0.0, _EDGE, 0.0, _EDGE)
#: What is no regular file.
_KINDS = {stat.S_IFIFO: "a named pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device", stat.S_IFSOCK: "a socket"}


@dataclass
class _Element:
    """An element with its place, and the folder of the included file that has it (None: of the model itself)."""

    tag: str
    values: dict[str, str]
    file: Path
    line: int
    folder: str | None = None
    children: list[_Element] = field(default_factory=list)

    def __str__(self) -> str:
        return f"{self.file}, line {self.line}: <{visible(self.tag, MAX_NAME)}>"

    def walk(self) -> Iterator[_Element]:
        """This element and all below it, in the order of the text."""
        yield self
        for child in self.children:
            yield from child.walk()


@dataclass(frozen=True)
class MissingFile:
    """A mesh, height field, skin or texture without its file.

    Args:
        kind: tag of the element.
        name: by which the model refers to it.
        refusal: why the file is not opened.
    """

    kind: str
    name: str
    refusal: InputError


@dataclass(frozen=True)
class JoinedModel:
    """An MJCF as one text, for which MuJoCo opens only files that were checked.

    Args:
        source: the path as the user gave it.
        path: the absolute one, without symbolic links to folders.
        texts: path → text of the model and of the models that it attaches. Each line has one element; lines are counted
            through all of them.
        lines: file and line of each line of the texts.
        files: all files that it is made of, and that MuJoCo opens.
        missing: files that are not opened; stand-ins without a file are in their place.
    """

    source: Path
    path: str
    texts: dict[str, str]
    lines: tuple[tuple[Path, int], ...]
    files: tuple[str, ...]
    missing: tuple[MissingFile, ...]


def joined_model(path: Path, assets: Sequence[Path] | None = ()) -> JoinedModel:
    """The model of a file, with its includes.

    Args:
        assets: further folders below which files may be opened; None where the user has no option to name one.

    Raises:
        InputError: no such file; not an MJCF; a file that is no regular file, missing, or outside of the folders.
    """
    root, place = _parsed(path, path), _physical(str(path))
    if not is_unicode(place):
        raise InputError(path, "a path with bytes that are no UTF-8", "a path of text, as MuJoCo needs it", "Rename it.")
    folders = (os.path.dirname(place), *(os.path.realpath(folder) for folder in assets or ()))
    joiner = _Joiner(place, folders, assets is not None)
    joiner.join(place, root, outer=True)
    files = tuple(dict.fromkeys(joiner.files))
    return JoinedModel(path, place, joiner.texts, tuple(joiner.lines), files, tuple(joiner.missing))


@dataclass
class _Joiner:
    """Joins a model and the models that it attaches."""

    model: str
    folders: tuple[str, ...]
    option: bool
    texts: dict[str, str] = field(default_factory=dict)
    lines: list[tuple[Path, int]] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    missing: list[MissingFile] = field(default_factory=list)
    opened: list[str] = field(default_factory=list)

    def join(self, place: str, root: _Element, outer: bool) -> None:
        """Write the text of the model at ``place``; ``outer``: it is not attached to another one."""
        if root.tag != "mujoco":
            found = "a URDF" if root.tag == "robot" else f"root element {shown(root.tag)}"
            raise InputError(root.file, found, "<mujoco> (MJCF)", "`sysid init --from` reads MJCF and URDF." if outer else "")
        self.opened.append(place)
        self.files.append(place)
        folder, included = os.path.dirname(place), {os.path.realpath(place)}
        root.children = list(self._with_includes(root.children, folder, None, included, 1))
        settings: dict[str, str] = {}
        for element in root.walk():
            if element.tag == "compiler":
                settings |= {key: element.values.pop(key) for key in _FOLDERS if key in element.values}
        for element in root.walk():
            self._find_files(element, folder, settings, outer)
        text = [""] * len(self.lines)
        self._write(root, text)
        self.texts[place] = "\n".join(text) + "\n"
        self.opened.pop()

    def _with_includes(
        self, elements: Sequence[_Element], folder: str, own: str | None, included: set[str], depth: int
    ) -> Iterator[_Element]:
        """The elements with those of included files in the place of each ``include``."""
        if depth > MAX_DEPTH:
            raise InputError(elements[0] if elements else self.model, f"nested deeper than {MAX_DEPTH} levels", "fewer levels")
        for element in elements:
            element.folder = own
            if element.tag.lower() != "include":
                element.children = list(self._with_includes(element.children, folder, own, included, depth + 1))
                yield element
                continue
            name = element.values.get("file", "")
            if not name or element.children:
                raise InputError(element, "no file name, or elements inside of it", '<include file="…"/>')
            path = self._file(element, name, _candidates(name, folder, folder, own))
            real = os.path.realpath(path)
            if real in included:
                raise InputError(element, f"{shown(name)} is included twice", "each file once", "Remove one of the two.")
            included.add(real)
            self.files.append(path)
            root = _parsed(Path(path), element)
            yield from self._with_includes(root.children, folder, os.path.dirname(path), included, depth + 1)

    def _find_files(self, element: _Element, folder: str, settings: dict[str, str], outer: bool) -> None:
        """Replace the names of files in an element by paths that were checked."""
        for key in [key for key in element.values if key.startswith("file")]:
            name = element.values[key]
            if not name:
                continue
            stripped = os.path.basename(name.replace("\\", "/")) if settings.get("strippath") == "true" else name
            base = "" if element.tag == "model" else settings.get("texturedir" if element.tag == "texture" else "meshdir", "")
            base = base or ("" if element.tag == "model" else settings.get("assetdir", ""))
            candidates = _candidates(stripped, folder, os.path.join(folder, base), element.folder)
            if element.tag == "skin":
                candidates += _candidates(stripped, folder, folder, None)
            try:
                path = self._file(element, name, candidates)
            except InputError as refusal:
                if element.tag not in _SHAPES or not outer:
                    raise
                own = element.values.get("name") or os.path.splitext(os.path.basename(name.replace("\\", "/")))[0]
                self.missing.append(MissingFile(element.tag, own, refusal))
                _stand_in(element, own)
                return
            self.files.append(path)
            if element.tag == "model":
                self._attach(element, path)
            element.values[key] = os.path.relpath(path, folder) if outer and element.tag != "model" else path

    def _attach(self, element: _Element, path: str) -> None:
        if path in self.opened:
            raise InputError(
                element, f"{shown(element.values['file'])} attaches itself", "another model", "Remove the element."
            )
        element.values.pop("content_type", None)
        if len(self.opened) > MAX_ATTACHED:
            raise InputError(element, f"models attached more than {MAX_ATTACHED} deep", "fewer levels")
        if path not in self.texts:
            self.join(path, _parsed(Path(path), element), outer=False)

    def _file(self, element: _Element, name: str, candidates: Sequence[str]) -> str:
        """The first candidate that exists.

        Raises:
            InputError: there is none, or it is outside of the folders or no regular file.
        """
        expected = f"a file below {self.folders[0]}"
        for candidate in candidates:
            path = _physical(candidate)
            try:
                mode = os.stat(path).st_mode
            except (OSError, ValueError):
                continue
            real = os.path.realpath(path)
            if not any(_below(real, folder) for folder in self.folders):
                there = f"Copy it there and name that place in {element.file.name}"
                option = f", or allow its folder with --assets {shlex.quote(os.path.dirname(real))}" if self.option else ""
                raise InputError(element, f"{shown(name)} is outside of the folder of the model", expected, f"{there}{option}.")
            if not stat.S_ISREG(mode):
                found = "a folder" if stat.S_ISDIR(mode) else _KINDS.get(stat.S_IFMT(mode), "no file")
                raise InputError(element, f"{shown(name)} is {found}", expected, "Name a file.")
            return path
        raise InputError(element, f"no file {shown(name)}", expected, f"Copy it to {shown(candidates[0])}.")

    def _write(self, element: _Element, text: list[str]) -> None:
        """Append the lines of an element."""
        self.lines.append((element.file, element.line))
        values = "".join(f" {key}={_quoted(value)}" for key, value in element.values.items())
        children = [child for child in element.children if child.tag]
        if not children:
            text.append(f"<{element.tag}{values}/>")
            return
        text.append(f"<{element.tag}{values}>")
        for child in children:
            self._write(child, text)
        text[-1] += f"</{element.tag}>"


def _candidates(name: str, model: str, base: str, own: str | None) -> list[str]:
    """Where MuJoCo looks for a file: below ``base``, then below the folder of the included file that names it."""
    found = [os.path.join(base, name)]
    return [*found, os.path.join(own, name)] if own is not None and own != model else found


def _physical(path: str) -> str:
    """The absolute path with real folders: the same place for the operating system and for MuJoCo, which joins texts."""
    return os.path.join(os.path.realpath(os.path.dirname(path)), os.path.basename(path))


def _below(path: str, folder: str) -> bool:
    return path.startswith(folder.rstrip("/") + "/")


def _stand_in(element: _Element, name: str) -> None:
    """Change an element so that it needs no file; a skin, to which nothing refers, loses its tag and is not written."""
    kept: dict[str, str] = {key: element.values[key] for key in ("class", "type") if key in element.values}
    shape: dict[str, dict[str, str]] = {
        "mesh": {"vertex": " ".join(map(str, STANDIN_MESH))},
        "hfield": {"nrow": "2", "ncol": "2", "size": "1 1 1 1", "elevation": " ".join(map(str, STANDIN_HEIGHTS))},
        "texture": {"builtin": "flat", "width": "1", "height": "1"},
        "skin": {},
    }
    element.values = {"name": name, **kept, **shape[element.tag]}
    element.children = []
    element.tag = "" if element.tag == "skin" else element.tag


def _quoted(value: str) -> str:
    return quoteattr(value, {"\n": "&#10;", "\r": "&#13;", "\t": "&#9;", '"': "&quot;"})


def _parsed(path: Path, where: object) -> _Element:
    """The root element of a file.

    Raises:
        InputError: no such file, no text, or not XML without a document type.
    """
    from xml.parsers import expat

    what = "an MJCF file"
    try:
        text = read_xml(path)
    except FileNotFoundError:
        raise InputError(where, "no such file", what, "Check the path.") from None
    except IsADirectoryError:
        raise InputError(where, "is a folder", what) from None
    except OSError as error:
        raise InputError(where, str(error.strerror or "cannot be opened").lower(), what, "Check the path.") from None
    except ValueError as error:
        raise InputError(where, str(error), what) from None
    if not text.strip():
        raise InputError(where, "the file is empty", what)
    parser = expat.ParserCreate("utf-8")
    around: list[_Element] = [_Element("", {}, path, 0)]

    def start(tag: str, values: dict[str, str]) -> None:
        element = _Element(tag, values, path, parser.CurrentLineNumber)
        if len(around) > MAX_DEPTH:
            raise InputError(element, f"nested deeper than {MAX_DEPTH} levels", "fewer levels")
        around[-1].children.append(element)
        around.append(element)

    def end(tag: str) -> None:
        around.pop()

    def refuse(*declared: object) -> None:
        raise InputError(where, "a document type", f"{what} without DTD or entities", "Remove the line with <!DOCTYPE.")

    parser.StartElementHandler, parser.EndElementHandler, parser.StartDoctypeDeclHandler = start, end, refuse
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        reason = f"{expat.errors.messages[error.code]}, line {error.lineno}"
        raise InputError(where, f"not readable as XML ({reason})", what) from None
    return around[0].children[0]
