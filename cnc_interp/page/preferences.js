// What the user of this browser prefers: inches, and a light page. It is kept beside the page.
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
