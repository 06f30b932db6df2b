// The page of all calls, `/docs`: Swagger UI over what the server says of itself. Its files are here, so it needs no internet.
/* global SwaggerUIBundle */

SwaggerUIBundle({ url: "openapi.json", dom_id: "#calls", deepLinking: true, validatorUrl: null });
