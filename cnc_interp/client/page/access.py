"""Who may command: pages that know the token, one of them at a time."""

from __future__ import annotations

import hmac
import secrets
from collections import Counter


class Access:
    """
    The token, and which page is in charge.

    Pages are told apart by their browser tab, so a refreshed page stays in charge; when the tab is
    closed they are free. Any page with the token may take them over, and may always stop the
    machine.

    Parameters
    ----------
    token : str
        The token; a random one when empty.

    """

    def __init__(self, token: str = ''):
        self.token = token or secrets.token_urlsafe(16)
        self._holder = ''
        self._pages: Counter[str] = Counter()

    def knows(self, token: str) -> bool:
        """Tell whether a token is the right one, in the same time for all wrong ones."""
        return hmac.compare_digest(token.encode(), self.token.encode())

    def enter(self, tab: str, token: str) -> None:
        """Let a page in; with the token it takes charge if no other page is."""
        self._pages[tab] += 1
        if not self._holder:
            self.take_over(tab, token)

    def leave(self, tab: str) -> None:
        """Let a page go; a tab that is refreshed has its new page before the old one goes."""
        self._pages[tab] -= 1
        if self._pages[tab] <= 0:
            del self._pages[tab]
            if self._holder == tab:
                self._holder = ''

    def take_over(self, tab: str, token: str) -> bool:
        """Put a page in charge."""
        if not self.knows(token):
            return False
        self._holder = tab
        return True

    def may_command(self, tab: str, token: str) -> bool:
        """Tell whether a page is in charge."""
        return self.knows(token) and tab == self._holder

    def may_stop(self, token: str) -> bool:
        """Tell whether a page may stop the machine: the token is enough."""
        return self.knows(token)
