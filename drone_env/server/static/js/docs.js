// The API reference at `/docs`: Swagger UI with local files.
/* global SwaggerUIBundle */

SwaggerUIBundle({ url: "openapi.json", dom_id: "#calls", deepLinking: true, validatorUrl: null });
