"""Let tests that ask the core the same question share its answer."""

import pickle
from collections.abc import Callable


def once(function: Callable) -> Callable:
    """Return the function, which computes the answer to the same question once."""
    answers = {}

    def answer(*words, progress=None, **more):
        question = pickle.dumps((words, more))
        if question not in answers:
            answers[question] = function(*words, **more)
        return answers[question]

    return answer
