window.drawMore = function () {
  var corners = JSON.parse(document.getElementById('corner-data').textContent);
  var choice = document.getElementById('corner-choice');
  function show() {
    var corner = corners[Number(choice.value)];
    ['space', 'profile'].forEach(function (part) {
      Plotly.react('corner-' + part, corner[part].data, corner[part].layout, CONTROLS);
    });
  }
  choice.addEventListener('change', show);
  show();
};
