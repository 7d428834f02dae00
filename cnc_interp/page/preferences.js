// Preferences of this browser's user: inches, and a light page. The browser stores them.
window.preferences = {
  toggle(name) {
    localStorage.setItem(name, localStorage.getItem(name) === 'on' ? '' : 'on');
    this.apply();
  },
  apply() {
    for (const name of ['inch', 'light']) {
      const key = document.querySelector(`[data-mark="${name}"]`);
      if (key) key.ariaPressed = localStorage.getItem(name) === 'on';
    }
    document.documentElement.classList.toggle('light', localStorage.getItem('light') === 'on');
    emitEvent('inch', localStorage.getItem('inch') === 'on', shown());
  },
};
