"""The promises of the asynchronous iteration, on every kind of board."""

from __future__ import annotations

import asyncio
import gc
import threading
import time
from collections.abc import Iterator

import pytest

from llfsm.whiteboard import Board, BoardClosedError, Message, Slot
from llfsm.whiteboard.subscription import Stream
from waiting import PATIENCE_S, wait_for

from .conftest import Observed


class Number(Message):
    value: int = 0


NUMBER = Slot("number", Number)


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    before = set(threading.enumerate())
    gc.freeze()  # so that a collection looks at what the test makes, and at nothing else
    yield
    gc.collect()
    wait_for(lambda: set(threading.enumerate()) <= before, "all threads have ended")


def test_each_message_is_given_once(board: Board) -> None:
    number = board[NUMBER]

    async def main() -> None:
        async with number.stream() as stream:
            for count in range(1, 101):
                number.add(Number(count))
                sample = await asyncio.wait_for(anext(stream), PATIENCE_S)
                assert sample == number.sample()
                assert sample.count == count
            assert stream.missed == 0

    asyncio.run(main())


def test_messages_come_while_others_use_the_loop(board: Board) -> None:
    """A stream waits without holding up the loop, in which here the writer runs, too."""
    number = board[NUMBER]

    async def read() -> list[int]:
        found = []
        async for sample in number.stream(backlog=1000):
            found.append(sample.count)
            if sample.count == 200:
                break
        return found

    async def main() -> None:
        reading = asyncio.create_task(read())
        for value in range(200):
            number.add(Number(value))
            await asyncio.sleep(0)
        found = await asyncio.wait_for(reading, PATIENCE_S)
        assert found == sorted(set(found))

    asyncio.run(main())


@pytest.mark.parametrize("backlog", [1, 3])
def test_a_busy_loop_gets_the_newest_and_no_more_than_the_backlog(
    board: Board, backlog: int
) -> None:
    number = board[NUMBER]
    for value in range(10):
        number.add(Number(value))

    async def main() -> None:
        async with number.stream(backlog=backlog) as stream:
            for value in range(10, 1000):  # which holds up the loop
                number.add(Number(value))
            found = []
            while not found or found[-1] < 1000:
                found.append((await asyncio.wait_for(anext(stream), PATIENCE_S)).count)
            assert found == sorted(set(found))
            assert stream.missed == 1000 - 9 - len(found)

    asyncio.run(main())


def test_wake_ups_do_not_pile_up_in_the_loop(board: Board) -> None:
    number = board[NUMBER]
    calls = 0

    async def main() -> None:
        nonlocal calls
        loop = asyncio.get_running_loop()
        call = loop.call_soon_threadsafe

        def counted(*arguments: object) -> asyncio.Handle:
            nonlocal calls
            calls += 1
            return call(*arguments)  # type: ignore[arg-type]

        loop.call_soon_threadsafe = counted  # type: ignore[method-assign,assignment]
        observed = Observed(number)
        async with Stream(observed, after=None, backlog=1) as stream:
            for value in range(1, 1001):
                number.add(Number(value))
                while observed.after < value:
                    time.sleep(0)
            assert calls == 1
            await anext(stream)

    asyncio.run(main())


def test_a_cancelled_wait_loses_nothing(board: Board) -> None:
    number = board[NUMBER]

    async def main() -> None:
        async with number.stream() as stream:
            for count in range(1, 20):
                waiting = asyncio.ensure_future(anext(stream))
                await asyncio.sleep(0)
                number.add(Number(count))
                if count % 2:
                    await asyncio.sleep(0.002)
                was_cancelled = waiting.cancel()
                try:
                    sample = await waiting
                except asyncio.CancelledError:
                    assert was_cancelled
                    sample = await asyncio.wait_for(anext(stream), PATIENCE_S)
                assert sample.count == count

    asyncio.run(main())


@pytest.mark.parametrize("end", ["break", "cancel", "time-out"])
def test_a_stream_that_is_let_go_ends_its_thread(board: Board, end: str) -> None:
    number = board[NUMBER]
    number.add(Number())

    async def read() -> None:
        async for _ in number.stream():
            if end == "break":
                break

    async def main() -> None:
        before = threading.active_count()
        reading = asyncio.create_task(read())
        await asyncio.sleep(0.01)
        if end == "cancel":
            reading.cancel()
            with pytest.raises(asyncio.CancelledError):
                await reading
        elif end == "time-out":
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(reading, 0.01)
        else:
            await reading
        del reading
        gc.collect()
        until = time.monotonic() + PATIENCE_S
        while threading.active_count() > before:
            assert time.monotonic() < until
            await asyncio.sleep(0.001)

    asyncio.run(main())


def test_aclose_ends_the_thread_and_the_iteration(board: Board) -> None:
    number = board[NUMBER]

    async def main() -> None:
        observed = Observed(number)
        stream = Stream(observed, after=None, backlog=1)
        waiting = asyncio.ensure_future(anext(stream))
        await asyncio.sleep(0)
        await stream.aclose()
        await stream.aclose()
        observed.after = -1
        number.add(Number())
        with pytest.raises(StopAsyncIteration):
            await waiting
        assert [sample async for sample in stream] == []
        assert observed.after == -1  # nobody waits for messages any more

    asyncio.run(main())


def test_what_was_not_taken_is_not_given_after_aclose(board: Board) -> None:
    number = board[NUMBER]
    number.add(Number())

    async def main() -> None:
        observed = Observed(number)
        stream = Stream(observed, after=None, backlog=1)
        while observed.after < 1:
            await asyncio.sleep(0)
        await stream.aclose()
        assert [sample async for sample in stream] == []

    asyncio.run(main())


@pytest.mark.parametrize("end", ["close", "remove"])
def test_the_iteration_ends_with_the_board(board: Board, end: str) -> None:
    number = board[NUMBER]
    number.add(Number())

    async def main() -> list[int]:
        found = []
        async for sample in number.stream():
            found.append(sample.count)
            getattr(board, end)()
        return found

    assert asyncio.run(main()) == [1]


def test_a_stream_that_outlives_its_loop_ends_its_thread(board: Board) -> None:
    number = board[NUMBER]

    async def main() -> object:
        return number.stream()

    before = set(threading.enumerate())
    stream = asyncio.run(main())
    number.add(Number())
    wait_for(lambda: set(threading.enumerate()) <= before, "the stream's thread has ended")
    del stream


def test_two_tasks_share_what_a_stream_gives(board: Board) -> None:
    number = board[NUMBER]

    async def main() -> None:
        observed = Observed(number)
        async with Stream(observed, after=None, backlog=100) as stream:
            waiting = [asyncio.ensure_future(anext(stream)) for _ in range(5)]
            await asyncio.sleep(0)
            for count in range(1, 6):
                number.add(Number())
                while observed.after < count:
                    await asyncio.sleep(0)
            found = await asyncio.wait_for(asyncio.gather(*waiting), PATIENCE_S)
            assert sorted(sample.count for sample in found) == [1, 2, 3, 4, 5]

    asyncio.run(main())


def test_a_stream_needs_a_loop_and_an_open_board(board: Board) -> None:
    number = board[NUMBER]
    with pytest.raises(RuntimeError, match="no running event loop"):
        number.stream()

    async def main(**arguments: int) -> None:
        number.stream(**arguments)

    with pytest.raises(ValueError, match="backlog=0"):
        asyncio.run(main(backlog=0))
    with pytest.raises(ValueError, match="after=-1"):
        asyncio.run(main(after=-1))
    board.close()
    with pytest.raises(BoardClosedError):
        asyncio.run(main())
