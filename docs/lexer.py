"""Colors of rule files."""

from typing import ClassVar

from pygments.lexer import RegexLexer, words
from pygments.token import Comment, Keyword, Name, Number, Operator, Punctuation, String, Text


class RuleLexer(RegexLexer):
    """A lexer of the rule language. It accepts any text, since examples of mistakes are text, too."""

    name = "Rules"
    aliases: ClassVar = ["dl"]
    filenames: ClassVar = ["*.dl"]
    tokens: ClassVar = {
        "root": [
            (r"///.*", String.Doc),
            (r"//.*", Comment.Single),
            (r"/\*(.|\n)*?\*/", Comment.Multiline),
            (r'"(\\.|[^"\\\n])*"', String),
            (r"[.#][a-z_]+", Keyword),
            (words(("Not", "not", "true", "false"), suffix=r"\b"), Keyword),
            (words(("count", "sum", "min", "max", "mean", "match", "contains", "range"), suffix=r"\b"), Name.Builtin),
            (r"(previous|once|since)(?=\s*\[|\s+[A-Za-z_?][\w?]*\()|(historically|for)(?=\s*\[)", Keyword),
            (words(("symbol", "number", "unsigned", "float"), suffix=r"\b"), Keyword.Type),
            (r"[A-Za-z_?][\w?]*(?=\()", Name.Function),
            (r"[A-Za-z_?][\w?]*", Name),
            (r"\d[\w.]*\w|\d", Number),
            (r":-|<:|!=|<=|>=|[=<>+\-*/%^|!]", Operator),
            (r"[().,;:{}\[\]]", Punctuation),
            (r"\s+", Text.Whitespace),
            (r".", Text),
        ]
    }
