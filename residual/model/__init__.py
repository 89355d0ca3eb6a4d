"""The model type, the nominal model, and the error of models on logs."""
