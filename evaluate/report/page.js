// Ties the page together: the player, links to replays, light and dark, Fig. 4's choice.

const data = JSON.parse(document.querySelector("#data").textContent);
const place = document.querySelector("#player");
const player = place && new Player(place, data);
const still = matchMedia("(prefers-reduced-motion: reduce)");

/** Plays once when the player first comes into view, unless the reader wants no motion. */
function playWhenSeen() {
  const seen = new IntersectionObserver(
    ([entry]) => {
      if (!entry.isIntersecting) return;
      seen.disconnect();
      if (!still.matches && player.time === player.begin) player.play();
    },
    { threshold: 0.35 },
  );
  seen.observe(place);
}

function remembered(theme) {
  try {
    if (theme) localStorage.setItem("theme", theme);
    return localStorage.getItem("theme");
  } catch {
    return null; // a page from disk may not be allowed to remember
  }
}

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  player?.redraw();
}

const dark = matchMedia("(prefers-color-scheme: dark)");
if (remembered()) setTheme(remembered());
document.querySelector("#theme").addEventListener("click", () => {
  const now = document.documentElement.dataset.theme || (dark.matches ? "dark" : "light");
  const next = now === "dark" ? "light" : "dark";
  remembered(next);
  setTheme(next);
});

const chosen = document.querySelector("#figure-4");
chosen.addEventListener("change", () => {
  for (const panel of document.querySelectorAll("[data-tasks-of]")) {
    panel.hidden = panel.dataset.tasksOf !== chosen.value;
  }
});

if (player) {
  for (const query of [dark, matchMedia("print")]) {
    query.addEventListener("change", () => player.redraw());
  }
  for (const link of document.querySelectorAll("[data-replay]")) {
    link.addEventListener("click", () => {
      player.open(data.episodes.findIndex((episode) => episode.name === link.dataset.replay));
      place.scrollIntoView({ block: "start" });
      place.focus({ preventScroll: true });
    });
  }
  playWhenSeen();
}
