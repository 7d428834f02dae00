(async () => {
  const packed = document.getElementById('packed'), text = packed.textContent;
  const bytes = new Uint8Array(text.length * 7 / 8);
  for (let i = 0, k = 0, bits = 0, count = 0; i < text.length; i += 1) {
    bits = (bits << 7 | text.charCodeAt(i) & 127) & 0xffff;
    count += 7;
    if (count > 7) { bytes[k] = bits >> (count -= 8); k += 1; }
  }
  const whole = new Blob([bytes.slice(0, packed.dataset.size)]);
  const unpacked = whole.stream().pipeThrough(new DecompressionStream('deflate'));
  const [library, ...texts] = (await new Response(unpacked).text()).split('\0');
  (0, eval)(library);
  document.querySelectorAll('script[type="application/json"]').forEach((element, i) => {
    element.textContent = texts[i];
    if (element.parentNode.className !== 'figure') return;
    const { data, layout } = JSON.parse(texts[i]);
    Plotly.newPlot(element.parentNode, data, layout, CONTROLS);
  });
  window.drawMore?.();
})();
