document.body.textContent = "semscape";
