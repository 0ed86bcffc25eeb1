"""Small safe XML reader on expat: no DTD, no entities, bounded size; elements know their place."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from xml.parsers import expat

from kempe.description.source import (
    Findings,
    Source,
    decode_text,
    make_error,
    refuse_other_kinds,
    shorten_text,
)
from kempe.errors import DescriptionError, Where

DEPTH_LIMIT = 100
"""Elements inside each other; robots need less than ten."""

ELEMENT_LIMIT = 1_000_000
"""Elements of the largest file that is read: seven times a chain of 20 000 links."""

_DECLARED = re.compile(rb"""\s*<\?xml[^>]*?\sencoding\s*=\s*["']([A-Za-z0-9._-]+)["']""")
_LATE = re.compile(r"(?>\s*(?:<!--.*?-->\s*)*)(?<!^)(<\?xml\s[^<>]*\?>)", re.DOTALL)
"""A declaration before which blanks or comments stand."""

_TAG_END = re.compile(r"""<[^>"']*(?:"[^"]*"[^>"']*|'[^']*'[^>"']*)*>""")

_ATTRIBUTE = re.compile(r"""\s([^\s=]+)(\s*=\s*(["'])).*?\3""", re.DOTALL)

_PIECE = re.compile(r"<!\[CDATA\[(.*?)\]\]>|<!--.*?-->|<[^>]*>|&[^;]*;", re.DOTALL)
"""What is not plain text inside an element."""


def _decode_piece(piece: re.Match[str]) -> str:
    """Return the characters that a piece of `_PIECE` stands for."""
    if piece[0].startswith("&"):
        return html.unescape(piece[0])
    return piece[1] or ""


_COMMENT = re.compile(r"<!--(.*?)-->", re.DOTALL)

_CODES = expat.errors.codes
_TRUNCATED = {
    _CODES[m]
    for m in (
        expat.errors.XML_ERROR_NO_ELEMENTS,
        expat.errors.XML_ERROR_UNCLOSED_TOKEN,
        expat.errors.XML_ERROR_PARTIAL_CHAR,
        expat.errors.XML_ERROR_UNCLOSED_CDATA_SECTION,
    )
}
_EXPLANATIONS = {
    _CODES[expat.errors.XML_ERROR_DUPLICATE_ATTRIBUTE]: (
        "an attribute is given twice",
        "give it once",
    ),
    _CODES[expat.errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT]: (
        "the file goes on after the end of its outermost element",
        "a file has one outermost element",
    ),
    _CODES[expat.errors.XML_ERROR_UNDEFINED_ENTITY]: (
        "an entity is used that XML does not have",
        "it has &amp; &lt; &gt; &quot; &apos; and &#number;",
    ),
    _CODES[expat.errors.XML_ERROR_BAD_CHAR_REF]: (
        "a character reference names a character that XML forbids",
        "remove it",
    ),
    _CODES[expat.errors.XML_ERROR_MISPLACED_XML_PI]: (
        "the line <?xml ...?> is not at the very start of the file",
        "remove all that stands before it",
    ),
}


class XmlElement:
    """XML element: `tag`, `attributes`, child elements `children`, and its place in its `source`."""

    __slots__ = ("_end", "_start", "attributes", "children", "source", "tag")

    def __init__(self, tag: str, attributes: dict[str, str], source: Source, start: int):
        self.tag = tag
        self.attributes = attributes
        self.source = source
        self.children: list[XmlElement] = []
        self._start = self._end = start

    @property
    def location(self) -> Where:
        """Place of the opening tag."""
        return self.source.locate_offset(self._start)

    def locate_attribute(self, attribute: str) -> Where:
        """Return the place of the value of an attribute; of the tag where the attribute is missing."""
        tag = _TAG_END.match(self.source.text, self._start)
        for match in _ATTRIBUTE.finditer(tag[0] if tag else ""):
            if match[1] == attribute:
                return self.source.locate_offset(self._start + match.end(1) + len(match[2]))
        return self.location

    @property
    def text(self) -> str:
        """Text of the element in the source, tags included."""
        text = self.source.text
        start = self._start
        tag = _TAG_END.match(text, start)
        assert tag is not None, "expat accepted the tag"
        if tag[0].endswith("/>"):
            return tag[0]
        return text[start : text.index(">", self._end) + 1]

    @property
    def content(self) -> str:
        """Text inside an element without children, without comments and without blanks at its ends."""
        inner = self._inner_text[1]
        if "<" in inner or "&" in inner:
            inner = _PIECE.sub(_decode_piece, inner)
        return inner.strip()

    @property
    def content_location(self) -> Where:
        """Place where the text inside the element begins; of its tag where there is none."""
        start, inner = self._inner_text
        if not inner.strip():
            return self.location
        return self.source.locate_offset(start + len(inner) - len(inner.lstrip()))

    @property
    def _inner_text(self) -> tuple[int, str]:
        """Text between the tags of the element, after its index in the source."""
        tag = _TAG_END.match(self.source.text, self._start)
        assert tag is not None, "expat accepted the tag"
        return tag.end(), "" if tag[0].endswith("/>") else self.source.text[tag.end() : self._end]

    def find_children(self, tag: str) -> list[XmlElement]:
        """Return the children with this tag."""
        return [child for child in self.children if child.tag == tag]

    def iterate_elements(self) -> Iterator[XmlElement]:
        """Iterate over the element and all elements below it, in the order of the file."""
        stack: list[XmlElement] = [self]
        while stack:
            element = stack.pop()
            yield element
            stack.extend(reversed(element.children))

    def __repr__(self) -> str:
        return f"<{self.tag}> at {self.location}"


def parse_xml(data: bytes | str, name: str, findings: Findings | None = None) -> XmlElement:
    """Return the outermost element of an XML text; `name` is the file's name, for messages.

    UTF-8, UTF-16 with a byte order mark, and Latin-1 where declared. With `findings`, a line
    ``<?xml ...?>`` that stands after comments and ``--`` inside of comments are noted and passed
    over, else they are refused. Errors: `DescriptionError` with line and column for what is not
    well-formed, truncated, too large or too deep, and for every DTD and entity declaration.
    """
    source = make_xml_source(data, name)
    text = source.text
    if findings is not None and (late := _LATE.match(text)):
        findings.add_note(
            "the line <?xml ...?> is not at the very start of the file, as XML has it; it is "
            "passed over",
            where=source.locate_offset(late.start(1)),
        )
        blank = re.sub(r"[^\r\n]", " ", late[1])
        source = Source(name, text[: late.start(1)] + blank + text[late.end(1) :])
    try:
        return _XmlBuilder(source).parse_source()
    except DescriptionError:
        dashes = [c for c in _COMMENT.finditer(source.text) if "--" in c[1]]
        if findings is None or not dashes:
            raise
    root = _XmlBuilder(Source(name, _COMMENT.sub(_replace_dashes, source.text))).parse_source()
    said = "a comment holds '--', which XML forbids; it is passed over"
    findings.add_note(said, where=source.locate_offset(dashes[0].start()))
    return root


def _replace_dashes(comment: re.Match[str]) -> str:
    """Return a comment of the same length that XML allows."""
    return f"<!--{comment[1].replace('-', ' ')}-->"


def make_xml_source(data: bytes | str, name: str) -> Source:
    """Return the decoded text of an XML file; `name` is the file's name, for messages.

    Errors: `DescriptionError` for what is no text, and for files of other kinds.
    """
    refuse_other_kinds(data, name)
    return Source(name, decode_text(data, name, _DECLARED))


class _XmlBuilder:
    """Builder of the tree of elements that expat reports."""

    def __init__(self, source: Source):
        self.source = source
        self.stack: list[XmlElement] = []
        self.root: XmlElement | None = None
        self.count = 0
        self.data = b""
        self.ascii = False
        self.byte = 0
        self.character = 0
        self.parser = expat.ParserCreate("utf-8")
        self.parser.StartElementHandler = self._start_element
        self.parser.EndElementHandler = self._end_element
        self.parser.StartDoctypeDeclHandler = self._refuse_doctype

    def _find_position(self) -> int:
        """Return the index into the source's text at which the parser is; it only increases."""
        byte = self.parser.CurrentByteIndex
        if self.ascii:
            return byte
        self.character += len(self.data[self.byte : byte].decode("utf-8"))
        self.byte = byte
        return self.character

    def _start_element(self, tag: str, attributes: dict[str, str]) -> None:
        """Add an element to the tree."""
        element = XmlElement(tag, attributes, self.source, self._find_position())
        if self.stack:
            self.stack[-1].children.append(element)
        else:
            self.root = element
        self.stack.append(element)
        self.count += 1
        if self.count > ELEMENT_LIMIT:
            raise make_error(
                f"the file has more than {ELEMENT_LIMIT} elements",
                element.location,
                "this is no robot's file",
            )
        if len(self.stack) > DEPTH_LIMIT:
            raise make_error(
                f"elements are nested more than {DEPTH_LIMIT} deep",
                element.location,
                "this is no robot's file",
            )

    def _end_element(self, tag: str) -> None:
        """Close the innermost open element."""
        self.stack.pop()._end = self._find_position()

    def _refuse_doctype(self, name: str, *_: object) -> None:
        """Raise `DescriptionError` for a DTD."""
        raise make_error(
            "the file has a DTD (<!DOCTYPE ...>)",
            self.source.locate_offset(self._find_position()),
            "remove it: a DTD can pull in other files or grow without bound, and is never read",
        )

    def parse_source(self) -> XmlElement:
        """Return the outermost element of the source.

        Errors: `DescriptionError`.
        """
        try:
            self.data = self.source.text.encode("utf-8")
            self.ascii = len(self.data) == len(self.source.text)
            self.parser.Parse(self.data, True)
        except expat.ExpatError as error:
            raise self._explain_error(error) from None
        except UnicodeEncodeError as error:
            raise make_error(
                "the text holds half of a surrogate pair, which is no character",
                self.source.locate_offset(error.start),
                "remove it",
            ) from None
        # the parser holds methods of this object, which holds the parser: without the cycle both go
        # at once
        finally:
            self.parser.StartElementHandler = self.parser.EndElementHandler = None
            self.parser.StartDoctypeDeclHandler = None
        assert self.root is not None, "expat refuses a text without elements"
        return self.root

    def _explain_error(self, error: expat.ExpatError) -> DescriptionError:
        """Return the error for a text that is no XML, with its place."""
        where = self.source.locate_line(error.lineno, error.offset + 1)
        inner = self.stack[-1] if self.stack else None
        if "<" not in self.source.text:
            return make_error(
                "the file holds no XML element",
                self.source.locate_line(1),
                "URDF starts with <robot name=...>",
            )
        if error.code in _TRUNCATED:
            inside = f" inside <{inner.tag}> opened on line {inner.location.line}" if inner else ""
            return make_error(
                f"the file ends{inside}: it is truncated", where, "get the whole file"
            )
        if error.code == _CODES[expat.errors.XML_ERROR_TAG_MISMATCH] and inner is not None:
            close = re.match(
                r"</[^\s>]*",
                self.source.text[self.source.compute_offset(where.line, where.column) - 2 :],
            )
            found = shorten_text(close[0] + ">") if close else "another closing tag"
            return make_error(
                f"{found} closes <{inner.tag}> opened on line {inner.location.line}",
                where,
                f"close it by </{inner.tag}>",
            )
        if error.code in _EXPLANATIONS:
            message, allowed = _EXPLANATIONS[error.code]
            return make_error(message, where, allowed)
        text = expat.errors.messages.get(error.code, "unknown error")
        return make_error(f"this is not XML ({text})", where, "see the caret" if where.text else "")
