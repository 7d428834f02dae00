// Keys that move an axis while they are held: a beat again and again until the key is let go, the
// page loses its focus, or the connection breaks. The machine stops by itself where no beat comes.
window.jog = {
  EVERY: 60, // time between beats [ms]
  KEYS: ARROWS,
  timer: 0,

  hold(name, sign) {
    this.release();
    const beat = () => contact.connected() && emitEvent('jog', { name, sign, heard: contact.beat });
    this.timer = setInterval(beat, this.EVERY);
    beat();
  },
  release() {
    if (!this.timer) return;
    clearInterval(this.timer);
    this.timer = 0;
    if (contact.connected()) emitEvent('jog', { name: '', sign: 0, heard: contact.beat });
  },
  pad() {
    const pad = document.querySelector('.jog');
    return pad?.offsetParent && pad.dataset.step === 'hold' ? pad : null;
  },
  arrow(event) {
    const key = this.KEYS[event.key];
    if (!key || !this.pad() || window.keyboard.typing(event.target) || event.target.closest('[role=slider]')) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (event.type === 'keyup') this.release();
    else if (!event.repeat && !event.ctrlKey && !event.altKey && !event.metaKey) this.hold(...key);
  },
};
for (const kind of ['keydown', 'keyup']) document.addEventListener(kind, (event) => jog.arrow(event), true);
for (const kind of ['pointerup', 'pointercancel', 'blur', 'contextmenu', 'visibilitychange'])
  window.addEventListener(kind, () => jog.release(), true);
