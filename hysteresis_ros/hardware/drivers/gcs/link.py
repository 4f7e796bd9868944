# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A controller that speaks GCS 2.0 over TCP, as its master sees it."""

from __future__ import annotations

import contextlib
import math
import re
import select
import socket

import numpy as np

from hysteresis_ros.hardware.driver import DriverError
from hysteresis_ros.hardware.drivers.gcs.protocol import NO_ERROR, STOP, STOPPED, meaning

#: What ends an answer, and what a line ends with after which another one follows.
END, MORE = b"\n", b" \n"
#: Most bytes at a time.
CHUNK = 65536
#: What no answer is longer than: a controller that says more is none, or out of order.
LONGEST_LINE, MOST_LINES = 1 << 20, 1 << 20
#: Most bytes of an answer that a message shows.
SHOWN = 60
#: The question for the last error, and what its answer looks like: no other answer in a sample does.
ERROR, CODE = "ERR?", re.compile(r"-?[0-9]{1,9}")


def _names(text: str) -> list[str]:
    """Return the words before an equals sign, hexadecimal numbers of parameters as decimal ones."""
    with contextlib.suppress(ValueError):
        return [str(int(word, 16)) if word[:2].lower() == "0x" else word for word in text.split()]
    return []


class GcsLink:
    """The connection to a controller: commands out, answers back, errors by what they mean.

    An answer has no number. So nothing may be under way when something is asked, each answer has to look like one to
    its question, and each exchange has the answer to ``ERR?``, which looks different. What does not fit breaks the
    link, as a missing answer does: from a line too many on, each answer would be the one before.

    Parameters
    ----------
    host : str
        Name or address.
    port : int
    timeout : float
        Time within which it connects and answers [s].

    Attributes
    ----------
    name : str
        For messages.
    broken : bool
        Whether nothing more can be said over it.

    Raises
    ------
    DriverError
        It cannot be reached.
    """

    def __init__(self, host: str, port: int, timeout: float):
        self.name = f"controller at {host}:{port}"
        self.broken = False
        self._rest = b""
        self._leads = False
        try:
            self._socket = socket.create_connection((host, port), timeout)
        except OSError as error:
            remedy = "switch it on, look at address and network, end other programs that use it"
            raise DriverError(self.name, f"cannot be reached ({error})", remedy) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, *commands: str) -> None:
        """Send commands that are not answered.

        Parameters
        ----------
        *commands : str
            Without line ends.

        Raises
        ------
        DriverError
            The connection is gone, or something came over it that nothing asked for.
        """
        self._put("".join(f"{command}\n" for command in commands), commands[0])

    def _put(self, text: str, what: str) -> None:
        self._require_silence(what)
        try:
            self._socket.sendall(text.encode("latin-1"))
        except OSError as error:
            raise self._gone(f"does not take {what!r} ({error})") from error

    def _require_silence(self, what: str) -> None:
        """Refuse what came before it was asked for: each later answer would be taken for that of another question."""
        said = self._rest
        if not said and select.select([self._socket], [], [], 0.0)[0]:
            said = self._receive(what)
        if said:
            text = said[:SHOWN].decode("latin-1")
            raise self._astray(f"says {text!r} before it is asked {what!r}, a line too many")

    def _gone(self, problem: str) -> DriverError:
        self.broken = True
        return DriverError(self.name, problem, "look at controller, network and other programs that use it")

    def _astray(self, problem: str) -> DriverError:
        """Return the error of an answer that is not that of its question; nothing more is believed of the link."""
        self.broken = True
        return DriverError(self.name, problem, "give the address of a controller with GCS 2.0, look at its network")

    def _receive(self, asked: str) -> bytes:
        try:
            data = self._socket.recv(CHUNK)
        except OSError as error:
            raise self._gone(f"does not answer {asked!r} ({error})") from error
        if not data:
            raise self._gone(f"has hung up at {asked!r}: it is off, or has another master")
        return data

    def _line(self, asked: str) -> bytes:
        while END not in self._rest:
            if len(self._rest) > LONGEST_LINE:
                raise self._gone(f"answers {asked!r} with more than {LONGEST_LINE} characters and no end")
            self._rest += self._receive(asked)
        line, _, self._rest = self._rest.partition(END)
        return line + END

    def _lines(self, question: str) -> list[str]:
        lines = [self._line(question)]
        while lines[-1].endswith(MORE):
            if len(lines) > MOST_LINES:
                raise self._gone(f"answers {question!r} with more than {MOST_LINES} lines")
            lines.append(self._line(question))
        return [line.decode("latin-1").rstrip() for line in lines]

    def ask(self, question: str) -> list[str]:
        """Return the lines of the answer to a question; the one to ``ERR?`` has to come behind it.

        Parameters
        ----------
        question : str
            Without line end.

        Raises
        ------
        DriverError
            There is no answer, or a line is missing or too many.
        """
        self.send(question, ERROR)
        lines = self._lines(question)
        self._code()
        return lines

    def ask_single(self, character: str) -> str:
        """Return the answer to a command of one character.

        Parameters
        ----------
        character : str

        Raises
        ------
        DriverError
            There is no answer.
        """
        name = f"#{ord(character)}"
        self._put(character, name)
        return self._line(name).decode("latin-1").rstrip()

    def find(self, question: str, item: str) -> str | None:
        """Return what a controller says of an item, ``1=2.5`` being ``2.5`` of the item ``1``; None when it refuses.

        Parameters
        ----------
        question : str
        item : str
            What stands before the equals sign.

        Raises
        ------
        DriverError
            There is no answer, or not that of the question.
        """
        return self._asked(question, item)[0]

    def value(self, question: str, item: str) -> str:
        """Return what a controller says of an item.

        Parameters
        ----------
        question : str
        item : str
            What stands before the equals sign.

        Raises
        ------
        DriverError
            It refuses, there is no answer, or not that of the question.
        """
        text, code = self._asked(question, item)
        if text is None:
            problem = f"does not answer '{question} {item}': {meaning(code)}"
            raise DriverError(self.name, problem, f"give a controller with GCS 2.0 that has {item}")
        return text

    def _asked(self, question: str, item: str) -> tuple[str | None, int]:
        asked = f"{question} {item}"
        self.send(asked, ERROR)
        lines = self._lines(asked)
        if CODE.fullmatch(lines[0]) and int(lines[0]) != NO_ERROR:
            return None, int(lines[0])  # the question has no answer, so that was the one to ERR?
        text = self._of_item(asked, item, lines)
        return text, self._code()

    def _of_item(self, asked: str, item: str, lines: list[str]) -> str:
        left, mark, right = lines[0].partition("=")
        if not mark or len(lines) != 1 or _names(left) != _names(item):
            raise self._astray(f"answers {asked!r} with {lines[0]!r}")
        return right.strip()

    def number(self, question: str, item: str) -> float:
        """Return the number that a controller says of an item.

        Parameters
        ----------
        question : str
        item : str
            What stands before the equals sign.

        Raises
        ------
        DriverError
            There is none.
        """
        return self._real(f"{question} {item}", self.value(question, item))

    def _real(self, asked: str, text: str) -> float:
        try:
            return float(text)
        except ValueError:
            raise self._astray(f"answers {asked!r} with {text!r}, which is no number") from None

    def numbers(self, *questions: tuple[str, str]) -> tuple[list[float], int]:
        """Return the numbers of items that are asked together, and the code of the last error.

        The answer to ``ERR?``, which has no equals sign, stands behind them at one time and before them at the next,
        and on both sides of several: a line too many or too few never leaves a number in another one's place, nor
        does a whole answer that comes again.

        Parameters
        ----------
        *questions : tuple of (str, str)
            Question and item.

        Raises
        ------
        DriverError
            There is no answer, or not that of its question.
        """
        several = len(questions) > 1
        before, behind = several or self._leads, several or not self._leads
        self._leads = not several and not self._leads
        asked = [f"{question} {item}" for question, item in questions]
        self.send(*[ERROR] * before, *asked, *[ERROR] * behind)
        codes = [self._code()] if before else []
        texts = [self._of_item(text, item, self._lines(text)) for text, (_, item) in zip(asked, questions, strict=True)]
        codes += [self._code()] if behind else []
        values = [self._real(*pair) for pair in zip(asked, texts, strict=True)]
        return values, next((code for code in codes if code != NO_ERROR), NO_ERROR)

    def table(self, question: str, tables: int) -> tuple[float, np.ndarray]:
        """Return the sample time [s] and the numbers of an answer that is an array, shape (points, tables).

        Parameters
        ----------
        question : str
        tables : int
            How many are asked for.

        Raises
        ------
        DriverError
            The answer is none.
        """
        lines = self.ask(question)
        head = dict(line[1:].split("=", 1) for line in lines if line.startswith("#") and "=" in line)
        head = {name.strip(): text.strip() for name, text in head.items()}
        try:
            separator = chr(int(head["SEPARATOR"]))
            rows = [line.split(separator) for line in lines if not line.startswith("#")]
            sample_time = float(head["SAMPLE_TIME"])
            if not (int(head["DIM"]) == tables and 0.0 < sample_time < math.inf):
                raise ValueError(f"{head['DIM']} tables of {sample_time:g} s")
            return sample_time, np.array(rows, dtype=float).reshape(int(head["NDATA"]), tables)
        except (KeyError, ValueError, OverflowError) as error:
            problem = f"answers {question!r} with no array ({type(error).__name__}: {error})"
            raise DriverError(self.name, problem, "look at the controller and its firmware") from None

    def error(self) -> int:
        """Return the code of the last error, which the controller forgets then.

        Raises
        ------
        DriverError
            The answer is no code.
        """
        self.send(ERROR)
        return self._code()

    def _code(self) -> int:
        """Return the code that the next answer is."""
        lines = self._lines(ERROR)
        if len(lines) != 1 or not CODE.fullmatch(lines[0]):
            raise self._astray(f"answers {ERROR!r} with {lines[0]!r}")
        return int(lines[0])

    def require(self, code: int, what: str) -> None:
        """Refuse any code but that of no error.

        Parameters
        ----------
        code : int
        what : str
            What was done, for the message.

        Raises
        ------
        DriverError
            There is an error.
        """
        if code != NO_ERROR:
            raise DriverError(self.name, f"{what}: {meaning(code)}", "mend the cause at the controller")

    def do(self, *commands: str) -> None:
        """Send commands and make sure that none was refused.

        Parameters
        ----------
        *commands : str

        Raises
        ------
        DriverError
            One was refused.
        """
        self.send(*commands)
        self.require(self.error(), f"refuses {commands[-1][:40]!r}")

    def stop(self) -> None:
        """Stop all motion; that counts as an error, which is taken.

        Raises
        ------
        DriverError
            It does not answer, or something else is wrong.
        """
        self._put(STOP, f"#{ord(STOP)}")
        code = self.error()
        if code != STOPPED:
            self.require(code, "does not stop")

    def close(self) -> None:
        """Hang up."""
        with contextlib.suppress(OSError):
            self._socket.close()
