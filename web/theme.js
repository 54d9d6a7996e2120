// Applies the chosen theme before the first paint. It is a classic script, because modules run after it.
(() => {
  try {
    const theme = localStorage.getItem('sdfarm.theme');
    if (theme === 'light' || theme === 'dark') document.documentElement.dataset.theme = theme;
  } catch {
    // Storage is off: the system's theme applies.
  }
})();
