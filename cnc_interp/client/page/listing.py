"""The text of the program: the browser fetches it once, shows what is in sight, and scrolls."""

from __future__ import annotations

from nicegui import ui

from cnc_interp.client.page.desk import Job


class Listing:
    """The text of the program in one page; it follows the executed line until its user scrolls."""

    def __init__(self) -> None:
        self._number = -1
        self._marked = (0, 0, 0)
        ui.html('<ol></ol>', sanitize=False).classes('lines').props('tabindex=0 data-mark="lines"')
        key = ui.button('to the line').props('dense no-caps unelevated color=blue-grey-8')
        key.props('data-mark="to the line"').classes('to-line')
        key.on('click', js_handler='() => listing.follow()')

    def show(self, job: Job | None, line: int, start: int) -> None:
        """
        Show a program.

        Parameters
        ----------
        job : Job, optional
            The program.
        line : int
            The line that is executed; 0 if none is.
        start : int
            The line at which the run starts; 0 for the top.

        """
        number = job.number if job is not None else 0
        marked = line, job.fault_line if job is not None else 0, start
        if number != self._number:
            ui.run_javascript(f'listing.load({number})')
        if (number, marked) != (self._number, self._marked):
            ui.run_javascript(f'listing.mark({", ".join(map(str, marked))})')
        self._number, self._marked = number, marked

    def show_again(self) -> None:
        """Show everything anew: the page has come back."""
        self._number = -1
