// The page's end of contact.py: tells the server which beat it has heard, shows when that beat is old,
// and resends a stop until it is answered, even after a reload of the page.
window.contact = {
  heard: performance.now(), // when the last beat arrived
  before: 0, // age of what the page showed then [ms]
  beat: 0,
  tried: 0, // when the connection was last up, or being tried
  // Unanswered stops by number: name and time of the press.
  stops: JSON.parse(sessionStorage.stops || '{}'),

  connected() {
    return window.socket?.connected && window.did_handshake;
  },
  hear(beat, age) {
    this.heard = performance.now();
    this.before = 1000 * age;
    this.beat = beat;
    this.answer();
  },
  answer() {
    if (this.connected()) emitEvent('heard', this.beat, !document.hidden);
  },
  age() {
    return performance.now() - this.heard + this.before;
  },
  stop(name) {
    this.stops[createRandomUUID()] = [name, Date.now()];
    this.keep();
    this.send();
  },
  answered(number) {
    delete this.stops[number];
    this.keep();
    this.say();
  },
  keep() {
    sessionStorage.stops = JSON.stringify(this.stops);
  },
  send() {
    // Without a connection requests would pile up, so the stop is sent with the next connection.
    if (!this.connected()) return;
    for (const [number, [name]] of Object.entries(this.stops)) emitEvent('stop', { number, name });
  },
  say() {
    const shown = document.querySelector('[data-mark="contact"]');
    if (!shown) return;
    const waiting = Object.values(this.stops).map(([name]) => name);
    const words = [];
    if (waiting.length) words.push(`${waiting.join(', ')}: sent until it is answered`);
    if (this.age() > 3000) words.push(`no contact: what is shown is ${Math.floor(this.age() / 1000)} s old`);
    shown.textContent = words.join('; ');
  },
  // The library gives up a connection that the server has refused or ended; this page tries again.
  connectAgain() {
    const now = performance.now();
    if (window.socket?.active !== false) this.tried = now;
    else if (now - this.tried > 15000) {
      this.tried = now;
      window.socket.connect();
    }
  },
  look() {
    this.connectAgain();
    for (const [number, [, pressed]] of Object.entries(this.stops))
      if (Date.now() - pressed > 60000) delete this.stops[number];
    this.keep();
    this.send();
    this.say();
  },
};
document.addEventListener('visibilitychange', () => window.contact.answer());
setInterval(() => window.contact.look(), 300);
// The texts in the fields of this page, by their marks.
window.shown = () => {
  const texts = {};
  for (const field of document.querySelectorAll('input[data-mark], [data-mark] input'))
    texts[field.closest('[data-mark]').dataset.mark] = field.value;
  return texts;
};
