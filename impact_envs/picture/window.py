"""A window that shows pictures at some speed, and the keys that change it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from impact_envs.errors import InputError

if TYPE_CHECKING:
    import pygame

KEYS = "space pauses, . makes a step, - and + change the speed, Esc ends"
FASTER = 2.0 ** (1 / 2)  # of a press: two of them double the speed
SLOWEST, FASTEST = 1 / 64, 64.0  # times real time
NAP = 0.005  # between two looks at the keys [s]


class Window:
    """Show pictures when their time has come.

    Args:
        size: width and height of the pictures [px].
        fps: most pictures per second.
        speed: time shown in one second; 1 is real time.
        on_key: called with the name of another key and whether it is pressed or let go.

    Attributes:
        speed: time shown in one second.
        paused: whether time stands still.
    """

    def __init__(
        self, size: tuple[int, int], fps: float, speed: float = 1.0, on_key: Callable[[str, bool], None] | None = None
    ) -> None:
        self._size, self._fps, self._on_key = size, fps, on_key
        self.speed, self.paused = speed, False
        self._steps = 0  # that were asked for in a pause
        self._surface: pygame.Surface | None = None
        self._shown: float | None = None  # time of the last picture [s]
        self._clock = 0.0  # when it was shown, on the wall's clock [s]

    def is_due(self, instant: float) -> bool:
        """Return whether a picture of an instant [s] is worth drawing: not if it would be seen too short."""
        if self._shown is None or self.paused or instant <= self._shown:
            return True
        return instant - self._shown >= self.speed / self._fps

    def show(self, picture: pygame.Surface, instant: float) -> None:
        """Show a picture once its time has come; in a pause that is when a step is asked for.

        Args:
            picture: of the window's size.
            instant: since the start of the episode [s].

        Raises:
            InputError: there is no display.
            KeyboardInterrupt: the user closed the window.
        """
        import pygame

        if self._surface is None:
            self._open()
        self._take_keys()
        while self._is_early(instant):
            time.sleep(NAP)
            self._take_keys()
        self._steps = max(0, self._steps - 1)
        assert self._surface is not None
        self._surface.blit(picture, (0, 0))
        pygame.display.flip()
        late = time.perf_counter() - self._clock - self._duration(instant)
        # The next picture counts from when this one should have been shown, unless that is long ago.
        self._clock = time.perf_counter() - (late if 0.0 < late < 1.0 / self._fps else 0.0)
        self._shown = instant

    def hold(self, seconds: float) -> None:
        """Stay for a while, or until the user closes the window."""
        end = time.perf_counter() + seconds
        while self._surface is not None and time.perf_counter() < end:
            try:
                self._take_keys()
            except KeyboardInterrupt:
                return
            time.sleep(NAP)

    def close(self) -> None:
        """Close the window; showing a picture opens a new one."""
        if self._surface is not None:
            import pygame

            pygame.display.quit()
            self._surface, self._shown = None, None

    def _open(self) -> None:
        import pygame

        pygame.display.init()
        if pygame.display.get_driver() == "offscreen":  # SDL's silent last resort
            pygame.display.quit()
            raise InputError("render mode 'human' finds no display; choices without one: rgb_array")
        self._surface = pygame.display.set_mode(self._size)
        self._write_title()

    def _write_title(self) -> None:
        import pygame

        state = "paused" if self.paused else f"{self.speed:.2g} x real time"
        pygame.display.set_caption(f"impact_envs: {state} ({KEYS})")

    def _duration(self, instant: float) -> float:
        """Return for how long the last picture is to be seen before one of an instant is shown [s]."""
        return 0.0 if self._shown is None else max(0.0, instant - self._shown) / self.speed

    def _is_early(self, instant: float) -> bool:
        if self._shown is None or instant < self._shown:
            return False
        if self.paused:
            return self._steps == 0
        return time.perf_counter() - self._clock < self._duration(instant)

    def _take_keys(self) -> None:
        """Do what keys ask for.

        Raises:
            KeyboardInterrupt: the user closed the window.
        """
        import pygame

        for event in pygame.event.get((pygame.QUIT, pygame.KEYDOWN, pygame.KEYUP)):
            if event.type == pygame.QUIT or (event.type == pygame.KEYDOWN and event.key == pygame.K_ESCAPE):
                self.close()
                raise KeyboardInterrupt("window closed")
            self._take_key(pygame.key.name(event.key), event.type == pygame.KEYDOWN)
        pygame.event.pump()

    def _take_key(self, name: str, pressed: bool) -> None:
        if name == "space" and pressed:
            self.paused = not self.paused
            self._steps, self._clock = 0, time.perf_counter()
        elif name == "." and pressed:
            self._steps += self.paused
        elif name in ("+", "=", "[+]") and pressed:  # = is on the key of + where that needs Shift
            self.speed = min(FASTEST, self.speed * FASTER)
        elif name in ("-", "[-]") and pressed:
            self.speed = max(SLOWEST, self.speed / FASTER)
        elif self._on_key is not None:
            self._on_key(name, pressed)
        self._write_title()
