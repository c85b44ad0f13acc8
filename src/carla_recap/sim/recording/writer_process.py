"""Writing a recording in a process of its own: no tick waits for a disk, and a killed simulation loses the last frames only.

`RecordingWriter` is the client of `python -m carla_recap.sim.recording.writer_process`, one process for each recording. It
sends commands over a pipe, as pickles; each one is answered by None or an error text. When the client has gone, the process
completes the recording and ends.

This is not `multiprocessing.Process`: its spawned processes import the caller's `__main__`, which starts another recording
in scripts without a guard, and workers of a pool must not start any.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from contextlib import suppress
from queue import Queue
from threading import Thread
from typing import TYPE_CHECKING, Any, BinaryIO, Final

from carla_recap.editing.recover import finish_partial
from carla_recap.errors import RecapError
from carla_recap.formats import create_writer
from carla_recap.sim.errors import DestinationError
from carla_recap.util.processes import close_pipes, module_command, module_environment, read_commands, wait_or_kill
from carla_recap.util.signals import broken_pipes_are_errors, ignore_termination

if TYPE_CHECKING:
    from pathlib import Path

    from carla_recap.formats.base import Writer
    from carla_recap.model.frame import Header
    from carla_recap.sim.recording.snapshots import SnapshotBatch

QUEUE: Final = 16
"""The number of batches that may wait; the simulation waits only for a disk that is that far behind."""
_READY: Final = b"carla-recap: ready to write recordings\n"
"""The first line of the process; lines before it are printed by other code that runs when an interpreter starts."""
_PATIENCE: Final = 30.0  # s, for the end of the process
_NICE: Final = 5  # the simulation goes first where processors are few; the writer needs a tenth of one


class WriterEnded(RecapError):
    """The process that writes a recording has ended by itself."""


class CommandFailed(RecapError):
    """A command has failed."""


class RecordingWriter:
    """Takes batches of snapshots without delay, and has each written once another one follows, by a process of its own.

    An error there ends the recording, and nothing else. If this process is killed, the recording is completed except for
    what has not been sent: the last batch, and those that wait for a slow disk. Without a process, a thread of this one
    writes, which is cheaper, and what is left of a killed one stays beside the destination, for `recover`.

    With `force`, a file at the destination is replaced at the end, else it stays, and the recording lies beside it. With
    `visible`, a recording without frames is put there at once; it is removed again if the recording fails, and nothing of it
    can be put in its place.

    Attributes:
        path: The destination.
        error: The error that ended the recording; None as long as there is none.

    Raises:
        DestinationError: The destination cannot be written to.
    """

    def __init__(
        self,
        path: Path,
        header: Header,
        process: subprocess.Popen[bytes] | None,
        *,
        force: bool = True,
        format: str | None = None,
        visible: bool = False,
    ) -> None:
        self.path = path
        self.error: RecapError | None = None
        self._batch: SnapshotBatch | None = None
        self._placeholder: int | None = None  # the inode of the recording without frames
        self._queue: Queue[SnapshotBatch | None] = Queue(QUEUE)
        self._thread = Thread(target=self._run, name="carla-recap-recorder", daemon=True)
        self._process = process
        self._commands = Commands()  # for want of a process
        self.pid = os.getpid() if process is None else process.pid
        try:
            self._command("begin", path, header, force, format, visible)
            self._placeholder = path.stat().st_ino if visible else None
            self._thread.start()
        except CommandFailed as error:
            self._end()
            raise DestinationError(str(error)) from None
        except BaseException:
            self._end()
            raise

    def write(self, batch: SnapshotBatch) -> None:
        """Add a batch, or what was added to it; errors appear in `error`, sooner or later."""
        if batch is not self._batch:
            self._write_batch()
            self._batch = batch

    def close(self) -> None:
        """Wait until the file is complete, or has failed; a second call does nothing."""
        if self._thread.is_alive():
            self._write_batch()
            self._queue.put(None)
            self._thread.join()

    def _write_batch(self) -> None:
        if self._batch is not None and self.error is None:
            self._queue.put(self._batch)

    def _run(self) -> None:
        batch: SnapshotBatch | None = None
        try:
            while (batch := self._queue.get()) is not None:
                self._command("write", batch)
            self._command("close")
        except WriterEnded as error:
            self.error = RecapError(f"{error}; what was recorded until then lies beside it, for carla-recap recover")
        except RecapError as error:
            self.error = error
        except Exception as error:
            self.error = RecapError(f"{self.path}: has ended early: {type(error).__name__}: {error}")
        self._end()
        if self.error is not None:
            self._remove_placeholder()
        while batch is not None:  # nothing that is put into the queue may wait for ever
            batch = self._queue.get()

    def _remove_placeholder(self) -> None:
        with suppress(OSError):
            if self.path.stat().st_ino == self._placeholder:
                self.path.unlink()

    def _command(self, name: str, *arguments: Any) -> None:
        """Have a command carried out; raise `CommandFailed`, or `WriterEnded`."""
        if self._process is None:
            error = self._commands.carry_out(name, arguments)
        else:
            error = self._answer(self._process, pickle.dumps((name, arguments), pickle.HIGHEST_PROTOCOL))
        if error is not None:
            raise CommandFailed(error)

    def _answer(self, process: subprocess.Popen[bytes], command: bytes) -> str | None:
        """Send a command to the process, and return its answer."""
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            with broken_pipes_are_errors():
                process.stdin.write(command)
                process.stdin.flush()
            answer: str | None = pickle.load(process.stdout)
        except Exception:
            self._end()
            reason = f"the process that writes it has ended with exit code {process.returncode}"
            raise WriterEnded(f"{self.path}: {reason}") from None
        return answer

    def _end(self) -> None:
        """Complete the recording if it is not complete yet, and end the process."""
        if self._process is None:
            with suppress(RecapError):
                self._commands.finish()
            return
        with broken_pipes_are_errors():
            with suppress(OSError, ValueError):
                assert self._process.stdin is not None
                self._process.stdin.write(pickle.dumps(None))  # a forked process may hold the pipe open
            close_pipes(self._process)
        wait_or_kill(self._process, _PATIENCE)


def start_process() -> subprocess.Popen[bytes]:
    """Start the process, and wait until it is ready; `RecapError`: it cannot be started.

    It is in a session of its own, where a terminal's signals, and those to this group, do not reach it.
    """
    command, pipe = module_command(__name__), subprocess.PIPE
    try:
        process = subprocess.Popen(command, stdin=pipe, stdout=pipe, env=module_environment(), start_new_session=True)
    except OSError as error:
        raise RecapError(f"the process that writes recordings cannot be started: {error}") from None
    try:
        assert process.stdout is not None
        while (line := process.stdout.readline()) != _READY:
            if not line:
                code = process.wait()
                raise RecapError(f"the process that writes recordings cannot be started: it has ended with exit code {code}")
    except BaseException:
        discard_process(process)
        raise
    return process


def discard_process(process: subprocess.Popen[bytes]) -> None:
    """End a process that no recording uses."""
    process.kill()
    close_pipes(process)
    process.wait()


# --- in the process ----------------------------------------------------------------------------------------------------


class Commands:
    """The commands, each a method; they write one recording after the other.

    A full or broken disk ends a recording: what the disk contains becomes a complete recording if possible; else it is left
    beside the destination for `recover`.
    """

    def __init__(self) -> None:
        self._writer: Writer | None = None
        self._is_empty = True

    def carry_out(self, name: str, arguments: tuple[Any, ...]) -> str | None:
        """Carry out a command; return the text of an error, if there is one."""
        try:
            getattr(self, name)(*arguments)
        except RecapError as error:
            return str(error)
        except Exception as error:
            return f"{type(error).__name__}: {error}"
        return None

    def begin(
        self, path: Path, header: Header, force: bool = True, format: str | None = None, visible: bool = False
    ) -> None:
        """Begin a recording; see `RecordingWriter`. `RecapError`: the destination cannot be written to."""
        writer = create_writer(path, header, live=True, force=force, format=format)
        if visible:
            try:
                create_writer(path, header, force=force, format=format).close()
            except BaseException:
                writer.abort()
                raise
        self._writer, self._path, self._format, self._is_visible = writer, path, format, visible
        self._is_empty = True

    def write(self, batch: SnapshotBatch) -> None:
        """Add the frames of a batch; an error says why the recording has ended, and where the recorded frames are."""
        assert self._writer is not None
        self._is_empty = False
        try:
            for frames in batch.batches():
                self._writer.write_batch(frames)
        except Exception as error:
            raise self._finish_partial(error) from None

    def close(self) -> None:
        """Complete the recording, if there is one; for errors, see `write`."""
        if self._writer is None:
            return
        try:
            self._writer.close()
        except Exception as error:
            raise self._finish_partial(error) from None
        self._writer = None

    def finish(self) -> None:
        """Complete a recording that was not closed; one without frames is removed. For errors, see `write`."""
        if self._writer is not None and self._is_empty:
            self._writer.abort()
        else:
            self.close()

    def _finish_partial(self, error: Exception) -> RecapError:
        assert self._writer is not None
        writer, self._writer = self._writer, None
        return finish_partial(writer, self._path, error, force=self._is_visible, format=self._format)


def serve(commands: BinaryIO, answers: BinaryIO) -> None:
    """Carry out commands (pickles of names and arguments, at last None) until there are no more; complete the recording."""
    recording = Commands()
    for name, arguments in read_commands(commands):
        answer = recording.carry_out(name, arguments)
        with suppress(OSError):  # the client has gone; no more commands will come
            pickle.dump(answer, answers)
            answers.flush()
    with suppress(RecapError):
        recording.finish()


def main() -> None:
    """Run the process."""
    ignore_termination()  # it ends when its client does
    if hasattr(os, "nice"):
        os.nice(_NICE)
    answers = sys.stdout.buffer
    sys.stdout = sys.stderr
    with suppress(OSError):  # the client may have gone by now
        answers.write(_READY)
        answers.flush()
        serve(sys.stdin.buffer, answers)


if __name__ == "__main__":
    main()
