// SPDX-License-Identifier: Apache-2.0
// Before the first paint: the theme that was chosen on this device, else that of the system.
"use strict";
(() => {
  let theme = null;
  try {
    theme = localStorage.getItem("motord.theme");
  } catch {
    // storage is switched off: the system's theme
  }
  if (theme === "light" || theme === "dark") document.documentElement.dataset.theme = theme;
})();
