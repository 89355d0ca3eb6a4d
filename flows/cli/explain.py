"""modelgap explain: an effect or a word, in plain English."""

from rich.console import Console
from rich.markdown import Markdown

from flows.report.words import explain as words
from flows.requests import Word


def explain(*word: Word) -> None:
    """Explain an effect, a verdict or any other word of the program.

    Without a word it lists all there are.

    ```
    modelgap explain stribeck
    modelgap explain minimum detectable
    ```

    Args:
        word: Name of an effect (stribeck), of a verdict (unknown), or a word that a
            report uses (nats).
    """
    text = words.explain(" ".join(word)) if word else words.overview()
    Console().print(Markdown(text))
