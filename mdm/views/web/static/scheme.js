// Light or dark: as the system says, unless somebody has chosen here.
const chosen = localStorage.getItem("scheme");
if (chosen) document.documentElement.dataset.scheme = chosen;
