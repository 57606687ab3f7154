from __future__ import annotations

import os
import threading

import pytest

from cellwright.cell.quiet_output import quiet_output


def test_what_is_written_to_the_descriptors_is_caught_and_later_words_pass(capfd: pytest.CaptureFixture[str]) -> None:
    with quiet_output() as lines:
        os.write(1, b"\x1b[31;1m**** ERR: one *****\n\n")
        os.write(2, b"two\n")
    os.write(1, b"after\n")
    assert lines == ["ERR: one", "two"]
    assert capfd.readouterr() == ("after\n", "")


def test_descriptors_come_back_after_an_error(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(KeyError), quiet_output():
        os.write(2, b"lost\n")
        raise KeyError
    os.write(2, b"after\n")
    assert capfd.readouterr() == ("", "after\n")


def test_threads_wait_for_one_another_and_keep_their_words_apart(capfd: pytest.CaptureFixture[str]) -> None:
    heard: dict[int, list[str]] = {}

    def speak(number: int) -> None:
        with quiet_output() as lines:
            for _ in range(20):
                os.write(1, f"{number}\n".encode())
        heard[number] = lines

    threads = [threading.Thread(target=speak, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert heard == {number: 20 * [str(number)] for number in range(4)}
    assert capfd.readouterr() == ("", "")
