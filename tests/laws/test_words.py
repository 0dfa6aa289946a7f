"""Words that people read: a text begins with its subject, in plain and British English.

Texts are docstrings with their `Args:` and `Attributes:`, comments, messages, help and the pages
of `docs/`. A name of a variable is a word that people read as well.
"""

import ast
import io
import re
import tokenize
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("systems", "diagrams", "sims", "urdf", "benchmarks", "examples")
FOLDERS = sorted(
    {
        "/".join(path.relative_to(ROOT).parts[:2])
        if len(path.relative_to(ROOT).parts) > 2
        else room
        for room in ROOMS
        for path in (ROOT / room).rglob("*.py")
    }
)
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])

# First words that leave out what the text is about; "true if" says what "whether" does.
_OPENINGS = re.compile(
    r"(of|that|what|which|as|with|by|how|whether|where|when|who|whose)\b|"
    r"(largest|smallest|least|mean|highest|lowest) (of|between|after|while|until|against)\b",
    re.I,
)
_MORE = "longer|more|less|farther|further|bigger|larger|faster|worse|better|smaller"
# Phrases with a plainer equivalent, and the equivalent.
_PHRASES = {
    r"\bnobody\b": "name who does not, or use the passive",
    rf"(?<!there )\b(?:is|are|was|were) no (?!(?:{_MORE})\b)\w+": "is not a ...",
    r"\bthat (?:is|are) none\b|\bthat there (?:is|are) not\b": "unknown, missing, not finite, ...",
    r"\bso many\b": "a number of ...",
    r"\bwhat is so\b": "say what",
    r"\blikewise\b": "also, or repeat the words",
}
# Spellings of the United States; names of libraries stand in code, which is not read.
_AMERICAN = re.compile(
    r"\b(centers?|centered|colors?|colored|gray|behaviors?|meters?|millimeters?|level(?:ed|ing)|"
    r"model(?:ed|ing)|label(?:ed|ing)|travel(?:ed|ing)|cancel(?:ed|ing)|neighbors?|analyze[sd]?|"
    r"(?:optim|regular|normal|linear|synchron|organ|recogn|quant|stabil|visual|minim|maxim)"
    r"iz(?:e[sd]?|ing|ation))\b",
    re.I,
)
# Texts that a rule does not fit, each with its reason.
_EXCEPTIONS = {
    "mobile machining centers": "title of the paper",
}
_PORTS = ("In", "Out", "Truth", "Inner")
_HEADING = re.compile(r"(\w[\w ]*):\s*$")
_ENTRY = re.compile(r"    (\*{0,2}\w[\w, *`.]*?)(?: \([^)]*\))?:\s+(\S.*)$")


class Text(NamedTuple):
    """A text of the sources.

    Attributes:
        place: file and line.
        text: the text; its first line where only that is judged.
        has_subject: true if it is to begin with its subject.
    """

    place: str
    text: str
    has_subject: bool


def _entries(docstring):
    """Texts of arguments and attributes in a docstring."""
    heading = ""
    for line in docstring.splitlines():
        if line and not line.startswith(" "):
            match = _HEADING.match(line)
            heading = match[1] if match else ""
        elif heading in ("Args", "Attributes") and (entry := _ENTRY.match(line)):
            yield entry[2]


def _strings(node):
    """Literal parts of a string or an f-string, joined."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(
            _strings(part) if isinstance(part, ast.Constant) else "X" for part in node.values
        )
    return ""


def _positional(call):
    """Positional arguments of a call, those of a tuple behind a star included."""
    for argument in call.args:
        inner = argument.value if isinstance(argument, ast.Starred) else argument
        yield from inner.elts if isinstance(inner, ast.Tuple) else (inner,)


def _constants(tree):
    """First lines of the statements that make constants."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef):
            for line in node.body:
                targets = (
                    line.targets
                    if isinstance(line, ast.Assign)
                    else [getattr(line, "target", None)]
                )
                if any(isinstance(t, ast.Name) and t.id.isupper() for t in targets):
                    yield line.lineno, line.end_lineno


def _comments(source):
    """Comments by line: those that stand alone, and those after code."""
    alone, after = {}, {}
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            text = token.string.lstrip("# ")
            is_alone = not token.line[: token.start[1]].strip()
            (alone if is_alone else after)[token.start[0]] = text
    return alone, after


@cache
def texts(path):
    """All texts of a file."""
    source, name, found = path.read_text(), path.relative_to(ROOT), []
    tree = ast.parse(source)

    def add(line, text, has_subject=False):
        found.append(Text(f"{name}:{line}", text, has_subject))

    documented = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            docstring = ast.get_docstring(node)
            if docstring:
                documented.add(id(node.body[0].value))
                line = node.body[0].lineno
                add(line, docstring)
                for text in _entries(docstring):
                    add(line, text, True)
    for node in ast.walk(tree):
        if isinstance(node, ast.keyword) and node.arg in ("help", "meaning"):
            add(node.value.lineno, _strings(node.value), True)
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in _PORTS:
            texts_of_port = [each for each in map(_strings, _positional(node)) if each]
            add(node.lineno, texts_of_port[-1] if texts_of_port else "", True)
        elif isinstance(node, ast.Constant | ast.JoinedStr) and id(node) not in documented:
            add(node.lineno, _strings(node))
    alone, after = _comments(source)
    for line, text in (alone | after).items():
        add(line, text)
    for first, last in _constants(tree):
        above = first - 1
        while above in alone:
            above -= 1
        if above < first - 1:
            add(above + 1, alone[above + 1], True)
        if last in after:
            add(last, after[last], True)
    return [text for text in found if not any(part in text.text for part in _EXCEPTIONS)]


def of_folder(folder):
    """Texts of the files of a folder of a room, or of those in the room itself."""
    pattern = "*.py" if "/" not in folder else "**/*.py"
    return [text for path in sorted((ROOT / folder).glob(pattern)) for text in texts(path)]


def fail_with(wrong):
    assert not wrong, "\n" + "\n".join(wrong)


each_folder = pytest.mark.parametrize("folder", FOLDERS)


@each_folder
def test_a_text_of_an_argument_a_constant_or_an_option_begins_with_its_subject(folder):
    fail_with(
        [
            f"{place}: {text}"
            for place, text, has_subject in of_folder(folder)
            if has_subject and _OPENINGS.match(text)
        ]
    )


def phrases(place, text):
    """Complaints about the words of a text."""
    text = " ".join(text.split())
    for pattern, instead in _PHRASES.items():
        for match in re.finditer(pattern, text, re.I):
            around = text[max(0, match.start() - 40) : match.end() + 30]
            yield f"{place}: '...{around}...': {instead}"


@each_folder
def test_no_text_has_a_phrase_with_a_plainer_equivalent(folder):
    fail_with([line for place, text, _ in of_folder(folder) for line in phrases(place, text)])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_are_plain_and_british_too(page):
    prose = re.sub(r"(?s)```.*?```|`[^`]*`|\]\([^)]*\)", " ", page.read_text())
    for part in _EXCEPTIONS:
        prose = re.sub(r"\s+".join(map(re.escape, part.split())), " ", prose)
    american = sorted({match[0] for match in _AMERICAN.finditer(prose)})
    fail_with([*phrases(page.name, prose), *american])


@each_folder
def test_spelling_is_british(folder):
    """In docstrings and comments; strings may be words of libraries, such as a plot's `color`."""
    wrong = []
    for path in (ROOT / folder).glob("*.py" if "/" not in folder else "**/*.py"):
        source = path.read_text()
        tree = ast.parse(source)
        kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
        parts = [ast.get_docstring(node) for node in ast.walk(tree) if isinstance(node, kinds)]
        prose = [*filter(None, parts), *(c for side in _comments(source) for c in side.values())]
        for text in prose:
            for match in _AMERICAN.finditer(re.sub(r"`[^`]*`", " ", text)):
                if not any(part in " ".join(text.split()) for part in _EXCEPTIONS):
                    wrong.append(f"{path.relative_to(ROOT)}: {match[0]}")
    fail_with(wrong)


# Participles that do not say of what: `reachable_poses` and `drawn_links` do.
_BARE = re.compile(
    "asked|begun|done|drawn|found|given|gone|heard|known|led|made|said|seen|shown|taken|told|"
    "tried|wanted"
)


@each_folder
def test_a_variable_says_what_it_holds(folder):
    """Variables of functions and their arguments; fields are read beside their object."""
    wrong = []
    for path in sorted((ROOT / folder).glob("*.py" if "/" not in folder else "**/*.py")):
        for function in ast.walk(ast.parse(path.read_text())):
            if not isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
                continue
            for node in ast.walk(function):
                if isinstance(node, ast.arg):
                    name, line = node.arg, node.lineno
                elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                    name, line = node.id, node.lineno
                else:
                    continue
                if _BARE.fullmatch(name):
                    wrong.append(f"{path.relative_to(ROOT)}:{line}: {name}")
    fail_with(sorted({*wrong}))


# Names of makers.
_NAMES_OF_OTHERS = {"SPI_FAILURE", "robot_description"}


def identifiers(tree):
    """Names that a module gives, each with its line."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr, node.lineno


def words_of(identifier):
    """Words of a name in snake or camel case."""
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", identifier)}


@each_folder
def test_names_have_the_words_of_the_glossary(folder):
    glossary = (ROOT / "docs" / "glossary.md").read_text().partition("## Symbols")[0]
    rows = re.findall(r"^\| ([\w, ]+) \| .* \| ([\w, ]*) ?\|$", glossary, re.MULTILINE)
    instead = {o: word for word, not_ in rows[1:] for o in not_.replace(",", " ").split()}
    assert instead["robot"] == "machine"
    wrong = []
    for path in sorted((ROOT / folder).glob("*.py" if "/" not in folder else "**/*.py")):
        named = [(path.stem, 1), *identifiers(ast.parse(path.read_text()))]
        for name, line in named:
            place = f"{path.relative_to(ROOT)}:{line}: {name}"
            if name not in _NAMES_OF_OTHERS:
                wrong += [f"{place}: {instead[w]}" for w in words_of(name) & instead.keys()]
            # A bench is the terrain simulator; the command is as well known as its name.
            if "bench" in words_of(name) and not re.search(
                r"terrain|bench_rt|^benchmarks", str(path.relative_to(ROOT))
            ):
                wrong.append(f"{place}: runner")
    fail_with(wrong)
