(() => {
const figure = document.currentScript.closest("figure");
const find = (selector) => figure.querySelector(selector);
const { dt, marks: spacing, frames } = JSON.parse(find('script[type="application/json"]').textContent);
const paths = figure.querySelectorAll(".figures path"), marks = find(".marks");
const button = find("button"), slider = find("input"), output = find("output");
let playing = false, time = 0, last = 0;
function show() {
  const index = Math.min(frames.length - 1, Math.floor(time / dt + 1e-6)), frame = frames[index];
  paths.forEach((path, i) => path.setAttribute("d", frame[i]));
  marks.setAttribute("transform", `translate(${-(frame[4] % spacing)} 0)`);
  slider.value = index;
  output.textContent = (index * dt).toFixed(2) + " s";
}
function step(now) {
  if (!playing) return;
  // A frame may be dated before the click that asked for it.
  time = (time + Math.max(0, now - last) / 1000) % (frames.length * dt);
  last = now;
  show();
  requestAnimationFrame(step);
}
function play(on) {
  playing = on;
  button.textContent = on ? "Pause" : "Play";
  last = performance.now();
  if (on) requestAnimationFrame(step);
}
button.addEventListener("click", () => play(!playing));
slider.addEventListener("input", () => { play(false); time = slider.value * dt; show(); });
show();
if (!matchMedia("(prefers-reduced-motion: reduce)").matches) play(true);
})();
