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


class GcsLink:
    """The connection to a controller: commands out, answers back, errors by what they mean.

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
            The connection is gone.
        """
        self._put("".join(f"{command}\n" for command in commands), commands[0])

    def _put(self, text: str, what: str) -> None:
        try:
            self._socket.sendall(text.encode("latin-1"))
        except OSError as error:
            raise self._gone(f"does not take {what!r} ({error})") from error

    def _gone(self, problem: str) -> DriverError:
        self.broken = True
        return DriverError(self.name, problem, "look at controller, network and other programs that use it")

    def _line(self, asked: str) -> bytes:
        while END not in self._rest:
            if len(self._rest) > LONGEST_LINE:
                raise self._gone(f"answers {asked!r} with more than {LONGEST_LINE} characters and no end")
            try:
                data = self._socket.recv(CHUNK)
            except OSError as error:
                raise self._gone(f"does not answer {asked!r} ({error})") from error
            if not data:
                raise self._gone(f"has hung up at {asked!r}: it is off, or has another master")
            self._rest += data
        line, _, self._rest = self._rest.partition(END)
        return line + END

    def ask(self, *questions: str) -> list[list[str]]:
        """Return the lines of the answers to questions that are sent together.

        Parameters
        ----------
        *questions : str
            Without line ends.

        Raises
        ------
        DriverError
            There is no answer.
        """
        self.send(*questions)
        return [self._lines(question) for question in questions]

    def _lines(self, question: str) -> list[str]:
        lines = [self._line(question)]
        while lines[-1].endswith(MORE):
            if len(lines) > MOST_LINES:
                raise self._gone(f"answers {question!r} with more than {MOST_LINES} lines")
            lines.append(self._line(question))
        return [line.decode("latin-1").rstrip() for line in lines]

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

    def ask_maybe(self, question: str) -> list[str] | None:
        """Return the lines of the answer to a question that may be refused; None when it is.

        Parameters
        ----------
        question : str

        Raises
        ------
        DriverError
            There is no answer.
        """
        self.send(question, "ERR?")
        lines = self._lines(question)
        if "=" not in lines[0]:
            self.code(lines)  # the question has no answer, so that was the one to ERR?
            return None
        self.code(self._lines("ERR?"))
        return lines

    def value(self, question: str, item: str, answer: list[str] | None = None) -> str:
        """Return what an answer says of an item, ``1=2.5`` being ``2.5`` of the item ``1``.

        Parameters
        ----------
        question : str
        item : str
            What stands before the equals sign.
        answer : list of str, optional
            Lines of the answer; without them it is asked.

        Raises
        ------
        DriverError
            The answer does not say it.
        """
        (line, *_), asked = answer or self.ask(f"{question} {item}")[0], f"{question} {item}"
        left, mark, right = line.partition("=")
        if not mark or left.split()[:1] != item.split()[:1]:
            problem = f"answers {asked!r} with {line!r}"
            raise DriverError(self.name, problem, f"give a controller with GCS 2.0 that has {item}")
        return right.strip()

    def number(self, question: str, item: str, answer: list[str] | None = None) -> float:
        """Return the number that an answer says of an item.

        Parameters
        ----------
        question : str
        item : str
            What stands before the equals sign.
        answer : list of str, optional
            Lines of the answer; without them it is asked.

        Raises
        ------
        DriverError
            There is none.
        """
        text = self.value(question, item, answer)
        try:
            return float(text)
        except ValueError:
            problem = f"answers '{question} {item}' with {text!r}, which is no number"
            raise DriverError(self.name, problem, "look at the controller and its firmware") from None

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
        lines = self.ask(question)[0]
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
        return self.code(self.ask("ERR?")[0])

    def code(self, answer: list[str]) -> int:
        """Return the code that an answer to ``ERR?`` is.

        Parameters
        ----------
        answer : list of str

        Raises
        ------
        DriverError
            It is none.
        """
        try:
            return int(answer[0])
        except ValueError:
            problem = f"answers 'ERR?' with {answer[0]!r}"
            raise DriverError(self.name, problem, "give the address of a controller with GCS 2.0") from None

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
