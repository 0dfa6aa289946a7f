"""Single changes to Python sources that a test should notice, found with `ast`."""

import ast
import bisect
import io
import random
import tokenize
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PurePosixPath

_OPERATORS: dict[type[ast.AST], tuple[str, str, tuple[str, ...]]] = {
    ast.Add: ("sign", "+", ("-",)),
    ast.Sub: ("sign", "-", ("+",)),
    ast.Mult: ("factor", "*", ("/",)),
    ast.Div: ("factor", "/", ("*",)),
    ast.Lt: ("comparison", "<", ("<=", ">")),
    ast.Gt: ("comparison", ">", (">=", "<")),
    ast.LtE: ("comparison", "<=", ("<",)),
    ast.GtE: ("comparison", ">=", (">",)),
    ast.Eq: ("comparison", "==", ("!=",)),
    ast.NotEq: ("comparison", "!=", ("==",)),
    ast.And: ("boolean", "and", ("or",)),
    ast.Or: ("boolean", "or", ("and",)),
}
# Functions to which the order of two arguments is nothing.
_COMMUTATIVE = {
    *("add", "allclose", "array_equal", "dot", "gcd", "hypot", "isclose", "max", "maximum"),
    *("min", "minimum", "multiply", "isinstance"),
}
# Names of what is never mistaken for its neighbour.
_UNMISTAKABLE = {"self", "builder", "context"}
# Optional arguments of other packages; those of the tree are read from its signatures.
# Without `strict` of zip, which like an assertion changes nothing while all is well.
_OPTIONAL = {
    *("axis", "copy", "daemon", "dtype", "initial", "keepdims", "key", "ndmin", "offset_sec"),
    *("prerequisites_of_calc", "reverse", "signed", "timeout"),
}
_MESSAGES = ("Error", "Warning", "Exception")
_LOGGING = {"critical", "debug", "exception", "info", "log", "print", "warn", "warning"}
_TEXTS = (ast.Constant, ast.JoinedStr)
_SEQUENCES = (ast.List, ast.Tuple, ast.Dict, ast.Set, ast.ListComp)
_CACHES = {"cache", "cached_property", "lru_cache"}


@dataclass(frozen=True)
class Mutant:
    """One change of one file.

    Attributes:
        path: file, relative to the tree.
        line: its line.
        kind: sign, factor, index, comparison, off by one, boolean, dropped or swapped arguments.
        start: first character that is replaced, from the beginning of the file.
        end: first character after those.
        text: replacement.
        before: the code around, as it is.
        after: and as it becomes.
        block: first and last line of the statement.
        names: names that the statement defines, if it is executed once and used later:
            at import or in a cached function.
    """

    path: str
    line: int
    kind: str
    start: int
    end: int
    text: str
    before: str
    after: str
    block: tuple[int, int]
    names: tuple[str, ...] | None

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.before} -> {self.after}"

    def applied(self, source: str) -> str:
        """The file's text with the change."""
        return source[: self.start] + self.text + source[self.end :]


def name_of(node: ast.AST) -> str:
    """Last name of a dotted one, of a call's function or of a decorator."""
    if isinstance(node, ast.Call):
        return name_of(node.func)
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def targets_of(node: ast.stmt) -> tuple[str, ...]:
    """Names that a statement assigns."""
    targets = getattr(node, "targets", None) or [getattr(node, "target", None)]
    named = (name for t in targets if t for name in ast.walk(t))
    return tuple(filter(None, map(name_of, named)))


def is_cached(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether a function keeps its result."""
    return any(name_of(decorator) in _CACHES for decorator in node.decorator_list)


def optional_arguments(trees: Iterable[ast.Module]) -> dict[str, set[str]]:
    """Arguments that have a default, by the name of the function or class."""
    arguments: dict[str, set[str]] = defaultdict(set)
    for node in (node for tree in trees for node in ast.walk(tree)):
        if isinstance(node, ast.ClassDef):
            for child in node.body:
                if isinstance(child, ast.AnnAssign) and child.value is not None:
                    arguments[node.name].update(targets_of(child))
                if isinstance(child, ast.FunctionDef) and child.name == "__init__":
                    arguments[node.name].update(_with_default(child.args))
        elif isinstance(node, ast.FunctionDef):
            arguments[node.name].update(_with_default(node.args))
    return arguments


def _with_default(arguments: ast.arguments) -> Iterator[str]:
    positional = [*arguments.posonlyargs, *arguments.args]
    yield from (a.arg for a in positional[len(positional) - len(arguments.defaults) :])
    both = zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
    yield from (a.arg for a, default in both if default is not None)


class _Finder(ast.NodeVisitor):
    """Lists the changes that one file admits."""

    def __init__(self, path: str, source: str, optional: Mapping[str, set[str]]) -> None:
        self.found: list[Mutant] = []
        self._path, self._source, self._optional = path, source, optional
        self._lines = source.splitlines(keepends=True)
        self._begins = [0]
        for line in self._lines:
            self._begins.append(self._begins[-1] + len(line))
        tokens = tokenize.generate_tokens(io.StringIO(source).readline)
        kinds = (tokenize.OP, tokenize.NAME)
        self._tokens = [
            (self._begins[t.start[0] - 1] + t.start[1], t.string)
            for t in tokens
            if t.type in kinds
        ]
        self._names: tuple[str, ...] | None = ()
        self._block = (1, 1)

    # Where things are

    def _span(self, node: ast.AST) -> tuple[int, int]:
        def offset(line: int, column: int) -> int:
            text = self._lines[line - 1].encode()[:column].decode()
            return self._begins[line - 1] + len(text)

        at: ast.expr = node  # type: ignore[assignment]
        assert at.end_lineno is not None
        assert at.end_col_offset is not None
        return offset(at.lineno, at.col_offset), offset(at.end_lineno, at.end_col_offset)

    def _token(self, text: str, begin: int, end: int) -> int | None:
        for at, string in self._tokens[bisect.bisect_left(self._tokens, (begin, "")) :]:
            if at >= end:
                return None
            if string == text:
                return at
        return None

    def _add(self, kind: str, start: int, end: int, text: str) -> None:
        line = bisect.bisect_right(self._begins, start)
        first = max(self._begins[line - 1], start - 30)
        last = min(self._begins[line] - 1, max(start, end) + 30)
        around = self._source[first:start], self._source[end : max(end, last)]
        before = "".join((around[0], self._source[start:end], around[1]))
        after = "".join((around[0], text, around[1]))
        before, after = (" ".join(code.split()) for code in (before, after))
        self.found.append(
            Mutant(
                self._path, line, kind, start, end, text, before, after, self._block, self._names
            )
        )

    def _operator(
        self, operator: ast.AST, left: ast.AST, right: ast.AST, suffix: str = ""
    ) -> None:
        if type(operator) not in _OPERATORS:
            return
        kind, sign, others = _OPERATORS[type(operator)]
        begin, end = self._span(left)[1], self._span(right)[0]
        at = self._token(sign + suffix, begin, end)
        if at is not None:
            for other in others:
                self._add(kind, at, at + len(sign), other)

    # Statements

    def visit(self, node: ast.AST) -> None:
        if not isinstance(node, ast.stmt):
            super().visit(node)
            return
        outer = self._block, self._names
        assert node.end_lineno is not None
        body = getattr(node, "body", None)
        last = node.end_lineno if not body else max(node.lineno, body[0].lineno - 1)
        self._block = (node.lineno, last)
        if self._names is not None and not isinstance(node, ast.ClassDef):
            # Names of a cached function remain; at import each statement has its own.
            self._names = targets_of(node) or self._names
        super().visit(node)
        self._block, self._names = outer

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        if node.name in ("__repr__", "__str__"):
            return
        outer = self._names
        if outer is not None:
            self._names = (node.name,)
        for child in (*node.decorator_list, *node.args.defaults, *node.args.kw_defaults):
            if child is not None:
                self.visit(child)
        self._names = (node.name,) if is_cached(node) else None
        for statement in node.body:
            self.visit(statement)
        self._names = outer

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        outer, self._names = self._names, (node.name,)
        for child in (*node.decorator_list, *node.body):
            self.visit(child)
        self._names = outer

    def visit_If(self, node: ast.If) -> None:
        if "TYPE_CHECKING" not in ast.unparse(node.test) and "__main__" not in ast.unparse(
            node.test
        ):
            self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self._operator(node.op, node.target, node.value, "=")
        self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> None:
        pass

    def visit_TypeAlias(self, node: ast.AST) -> None:
        pass

    # Expressions

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        pass

    def visit_BinOp(self, node: ast.BinOp) -> None:
        is_text = any(
            isinstance(side, _TEXTS) and not isinstance(getattr(side, "value", ""), (int, float))
            for side in (node.left, node.right)
        )
        is_sequence = isinstance(node.left, _SEQUENCES) or isinstance(node.right, _SEQUENCES)
        if not (is_text or is_sequence):
            self._operator(node.op, node.left, node.right)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        for left, right in pairwise(node.values):
            self._operator(node.op, left, right)
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        for operator, (left, right) in zip(
            node.ops, pairwise([node.left, *node.comparators]), strict=True
        ):
            self._operator(operator, left, right)
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        start = self._span(node)[0]
        if isinstance(node.op, ast.USub):
            self._add("sign", start, start + 1, "")
        elif isinstance(node.op, ast.Not):
            self._add("boolean", start, self._span(node.operand)[0], "")
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        if type(node.value) in (int, float):
            self._add("factor", *self._span(node), repr(2 * node.value or 1))  # type: ignore[operator]

    def _step(self, node: ast.AST | None, kind: str) -> None:
        """An integer constant becomes the next one; of others the parts are changed."""
        value = node.operand if isinstance(node, ast.UnaryOp) else node
        if isinstance(value, ast.Constant) and type(value.value) is int:
            assert node is not None
            whole = -value.value if node is not value else value.value
            self._add(kind, *self._span(node), str(whole + 1))
        elif node is not None:
            self.visit(node)

    def visit_Subscript(self, node: ast.Subscript) -> None:
        self.visit(node.value)
        if name_of(node.value) in ("Literal", "Annotated"):
            return
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        for part in parts:
            if isinstance(part, ast.Slice):
                for end in (part.lower, part.upper, part.step):
                    self._step(end, "off by one")
            else:
                self._step(part, "index")

    def visit_Call(self, node: ast.Call) -> None:
        name = name_of(node.func)
        if name in _LOGGING or name.endswith(_MESSAGES):
            return
        self.visit(node.func)
        for argument in node.args:
            if name == "range":
                self._step(argument, "off by one")
            else:
                self.visit(argument)
        for keyword in node.keywords:
            self.visit(keyword.value)
            if keyword.arg in _OPTIONAL or keyword.arg in self._optional.get(name, ()):
                self._drop(keyword)
        if name not in _COMMUTATIVE:
            for one, other in pairwise(node.args):
                self._swap(one, other)

    def _drop(self, keyword: ast.keyword) -> None:
        start, end = self._span(keyword)
        at = bisect.bisect_left(self._tokens, (end, ""))
        if self._tokens[at][1] == ",":
            end = self._tokens[at][0] + 1
            while self._source[end] == " ":
                end += 1
        else:
            before = self._tokens[bisect.bisect_left(self._tokens, (start, "")) - 1]
            start = before[0] if before[1] == "," else start
        self._add("dropped argument", start, end, "")

    def _swap(self, one: ast.expr, other: ast.expr) -> None:
        def kind(node: ast.expr) -> type | None:
            if isinstance(node, ast.Constant):
                return type(node.value)
            return type(node) if isinstance(node, ast.Name | ast.Attribute) else None

        (first, middle), (rest, end) = self._span(one), self._span(other)
        texts = self._source[first:middle], self._source[rest:end]
        if texts[0] == texts[1] or _UNMISTAKABLE.intersection(texts):
            return
        if kind(one) is kind(other) is not None:
            between = self._source[middle:rest]
            self._add("swapped arguments", first, end, texts[1] + between + texts[0])


def list_mutants(root: Path, paths: Sequence[str]) -> list[Mutant]:
    """All changes that the .py files under some paths of a tree admit, in order."""
    python_files = (
        file for path in paths for file in (root / path, *sorted((root / path).rglob("*")))
    )
    files = sorted({file for file in python_files if file.suffix == ".py" and file.is_file()})
    sources = {file: file.read_text(encoding="utf-8") for file in files}
    trees = {file: ast.parse(source) for file, source in sources.items()}
    optional = optional_arguments(trees.values())
    mutants: list[Mutant] = []
    for file, source in sources.items():
        finder = _Finder(file.relative_to(root).as_posix(), source, optional)
        finder.visit(trees[file])
        mutants += sorted(finder.found, key=lambda mutant: (mutant.start, mutant.text))
    return mutants


def draw(mutants: Sequence[Mutant], count: int, seed: int, root: Path) -> list[Mutant]:
    """A sample in which every folder has a part by the lines of its files, one at least.

    Within a folder a file is drawn by its lines, and then any of its changes; those that give no
    other program are passed over. Equal arguments give an equal sample.
    """
    by_file: dict[str, list[Mutant]] = defaultdict(list)
    for mutant in mutants:
        by_file[mutant.path].append(mutant)
    sources = {path: (root / path).read_text(encoding="utf-8") for path in by_file}
    lines = {path: source.count("\n") for path, source in sources.items()}
    folders: dict[str, list[str]] = defaultdict(list)
    for path in by_file:
        folders[str(PurePosixPath(path).parent)].append(path)
    sizes = {folder: sum(lines[path] for path in paths) for folder, paths in folders.items()}
    drawn_mutants: list[Mutant] = []
    for folder, quota in _shares(sizes, count).items():
        chance = random.Random(f"{seed} {folder}")
        files_left = {path: list(by_file[path]) for path in folders[folder]}
        target = len(drawn_mutants) + quota
        while len(drawn_mutants) < target and files_left:
            (path,) = chance.choices(list(files_left), [lines[path] for path in files_left])
            mutant = files_left[path].pop(chance.randrange(len(files_left[path])))
            if not files_left[path]:
                del files_left[path]
            if _is_other(sources[path], mutant):
                drawn_mutants.append(mutant)
    return sorted(drawn_mutants, key=lambda mutant: (mutant.path, mutant.start, mutant.text))


def _shares(sizes: Mapping[str, int], count: int) -> dict[str, int]:
    """Parts of a count in proportion to sizes, one at least, by largest remainder."""
    total = sum(sizes.values())
    exact = {name: count * size / total for name, size in sizes.items()}
    shares = {name: max(1, int(value)) for name, value in exact.items()}
    by_remainder = sorted(exact, key=lambda name: shares[name] - exact[name])
    for name in by_remainder[: max(0, count - sum(shares.values()))]:
        shares[name] += 1
    return shares


def _is_other(source: str, mutant: Mutant) -> bool:
    """Whether a change gives a program, and another one."""
    try:
        changed = ast.parse(mutant.applied(source))
    except SyntaxError:
        return False
    return ast.dump(changed) != ast.dump(ast.parse(source))
