// Keys that move an axis while they are held: beats are repeated until the pointer leaves or releases the
// key, the window loses the focus, or the contact breaks. Without beats the machine stops by itself.
// If something other than the user ends or delays the motion, a message says so.
window.jog = {
  EVERY: 60, // time between beats [ms]
  LATE: 200, // delay of the page from which on a press is reported as late [ms]
  OLD: STALE, // silence of the server after which a held key must be pressed again [ms]
  GONE: LOST, // message if neither the user nor the contact ended the motion
  KEYS: ARROWS,
  FILLS: FILLED, // time for which a key that starts a rapid must be held [ms]
  timer: 0,
  key: null, // the key that a pointer holds

  hold(name, sign, pressed) {
    this.release();
    const beat = () => {
      if (contact.connected() && performance.now() - contact.heard < this.OLD)
        emitEvent('jog', { name, sign, heard: contact.beat });
      else this.release(AGAIN);
    };
    this.timer = setInterval(beat, this.EVERY);
    const late = performance.now() - pressed;
    if (late < this.LATE) beat();
    // The release may already be waiting: it is processed before the first beat of the timer.
    else this.say(`this page is busy: the key moves ${(late / 1000).toFixed(1)} s after the press`);
  },
  release(why) {
    const filling = this.key?.matches('.filling');
    this.key?.classList.remove('filling');
    this.key = null;
    if (!this.timer) return;
    clearInterval(this.timer);
    this.timer = 0;
    if (filling) return this.say(EARLY);
    if (contact.connected()) emitEvent('jog', { name: '', sign: 0, heard: contact.beat });
    if (why) this.say(why);
  },
  say(message) {
    Quasar.Notify.create({ type: 'warning', message });
  },
  pad() {
    const pad = document.querySelector('.jog');
    return pad?.getClientRects().length && pad.dataset.step === 'hold' ? pad : null;
  },
  press(event, name, sign) {
    if (!this.pad() || !event.isPrimary || event.button) return;
    this.hold(name, sign, event.timeStamp);
    this.take(event);
  },
  take(event) {
    this.key = event.currentTarget;
    this.key.setPointerCapture(event.pointerId); // else events of a pointer outside the window are lost
  },
  fill(event, name) {
    if (!event.isPrimary || event.button) return;
    this.release();
    this.take(event);
    this.key.classList.add('filling');
    this.timer = setTimeout(() => {
      this.timer = 0;
      this.release();
      if (contact.connected() && performance.now() - contact.heard < this.OLD)
        emitEvent('go_to_zero', { name, heard: contact.beat });
      else this.say(AGAIN);
    }, this.FILLS);
  },
  slide(event) {
    const box = this.key?.getBoundingClientRect();
    const { clientX: x, clientY: y } = event;
    if (box && !(x >= box.left && x <= box.right && y >= box.top && y <= box.bottom)) this.release();
  },
  arrow(event) {
    const key = this.KEYS[event.key];
    if (!key || !this.pad() || window.keyboard.typing(event.target) || event.target.closest('[role=slider]')) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (event.type === 'keyup') this.release();
    else if (!event.repeat && !event.ctrlKey && !event.altKey && !event.metaKey) this.hold(...key, event.timeStamp);
  },
};
for (const kind of ['keydown', 'keyup']) document.addEventListener(kind, (event) => jog.arrow(event), true);
window.addEventListener('pointerup', () => jog.release(), true);
for (const kind of ['pointercancel', 'lostpointercapture', 'pagehide', 'visibilitychange'])
  window.addEventListener(kind, () => jog.release(jog.GONE), true);
window.addEventListener('pointermove', (event) => jog.slide(event), true);
// Without capture, because the blur of an element is not that of the window.
window.addEventListener('blur', () => jog.release(jog.GONE));
// A finger that rests on a key must not open a menu.
document.addEventListener('contextmenu', (event) => event.target.closest('.jog, .held') && event.preventDefault());
