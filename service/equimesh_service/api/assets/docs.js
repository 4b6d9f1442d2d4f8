// Starts Swagger UI. A file of its own: the page's policy allows no scripts inside it.
const description = new URL("../../openapi.json", document.currentScript.src);
SwaggerUIBundle({
  url: description.pathname,
  dom_id: "#swagger-ui",
  layout: "BaseLayout",
  deepLinking: true,
  tryItOutEnabled: true,
  validatorUrl: null,
  presets: [SwaggerUIBundle.presets.apis, SwaggerUIBundle.SwaggerUIStandalonePreset],
});
