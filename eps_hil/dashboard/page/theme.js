// Before anything is drawn: the scheme that was chosen last, else the system's.
"use strict";
{
  let chosen = null;
  try { chosen = localStorage.getItem("eps_hil.theme"); } catch { /* no storage: the system's */ }
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = chosen || (dark ? "dark" : "light");
}
